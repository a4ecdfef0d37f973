"""What the stamps of a record leave open of every delay in it: their scatter, and clocks that run apart.

An output whose clock runs fast or slow against that of the inputs comes later and later, or earlier. What the
free run leaves over then holds the run's own slope, times the time:

    y(t) - run(t) = (late + rate t) run'(t) + ...

`rate` is fitted by least squares to what is left, without its colour. A plant that changes while it flies
looks alike.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flysid.dataset import JITTER, Dataset, FloatArray
from flysid.filters import apply_filter
from flysid.model.noise import noise_model
from flysid.model.polynomials import Z95
from flysid.model.transfer_function import FittedTF
from flysid.showing import significant

ONE = np.ones(1)


@dataclass(frozen=True)
class Stamps:
    """What stamps say of the delay from the inputs to one output.

    Attributes
    ----------
    jitter_s : standard deviation of the inputs' stamps about an even rate.
    growth_s : how much more the output lags at the end of the longest flight than at its beginning.
    error_s : standard error of that; inf where it is not known.
    """

    jitter_s: float
    growth_s: float = 0.0
    error_s: float = np.inf

    @property
    def late_s(self) -> float:
        """Standard error of a delay of the record, from its stamps alone.

        Where the delay grows beyond chance, half of that: what it is in the middle of the record is known,
        not what it is in truth.
        """
        if abs(self.growth_s) <= Z95 * self.error_s:
            return self.jitter_s
        half = 0.5 * np.sqrt(self.growth_s**2 - self.error_s**2)
        return float(np.hypot(self.jitter_s, half))

    def caution(self, highest: float, *, doubt: float = 1e-3, least_deg: float = 0.1) -> str:
        """That the delay grows, where that is beyond doubt and turns the phase; else "".

        Parameters
        ----------
        highest : where the trusted band ends, rad/s.
        doubt : how often chance alone may look like it.
        least_deg : turn at `highest` from which it is told; the table of responses prints tenths.
        """
        from scipy.special import ndtri

        clear = abs(self.growth_s) > -float(ndtri(doubt / 2.0)) * self.error_s
        half = 0.5 * abs(self.growth_s)
        if not clear or np.degrees(half * highest) < least_deg:
            return ""
        size = f"{significant(1e3 * abs(self.growth_s), 2)} +- {significant(1e3 * Z95 * self.error_s, 2)} ms"
        return (
            f"the output comes {size} {'later' if self.growth_s > 0.0 else 'earlier'} at the end of a flight "
            "than at its beginning. Two clocks that run apart look like this, and so does a plant that "
            f"changes. The intervals of phase and dead time hold +-{significant(1e3 * half, 2)} ms of it"
        )


def read_stamps(data: Dataset, model: FittedTF | None, output: int) -> Stamps:
    """From the marks of a dataset and, of a model that runs free, from what its run leaves over."""
    jitter_s = max((float(s.marks.get(JITTER, 0.0)) for s in data.segments), default=0.0)
    if model is None or not model.is_stable:
        return Stamps(jitter_s)
    parts = list(_left_over(data, model, output))
    if not parts:
        return Stamps(jitter_s)
    whiten, _ = noise_model([part[:, 0] for part in parts])
    white = [np.column_stack([apply_filter(whiten, ONE, c) for c in part.T])[len(whiten) :] for part in parts]
    target, rows = np.split(np.concatenate(white), [1], axis=1)
    size = np.linalg.norm(rows, axis=0)
    if not (size > 0.0).all() or len(rows) <= rows.shape[1]:
        return Stamps(jitter_s)
    rows = rows / size
    found, _, rank, _ = np.linalg.lstsq(rows, target[:, 0], rcond=None)
    if rank < rows.shape[1]:
        return Stamps(jitter_s)
    left = target[:, 0] - rows @ found
    variance = float(left @ left) / (len(rows) - rank) * float(np.linalg.inv(rows.T @ rows)[0, 0])
    longest = max(stop - start for start, stop in _flights(data).values())
    # a run that comes late has lost its slope times the delay
    return Stamps(
        jitter_s, float(-found[0] / size[0] * longest), float(np.sqrt(variance) / size[0] * longest)
    )


def _flights(data: Dataset) -> dict[str, tuple[float, float]]:
    """When every flight begins and ends, s."""
    ends: dict[str, list[float]] = defaultdict(list)
    for s in data.segments:
        ends[s.flight] += [1e-9 * s.t0_ns, 1e-9 * s.t0_ns + len(s) * data.dt_s]
    return {name: (min(own), max(own)) for name, own in ends.items()}


def _left_over(data: Dataset, model: FittedTF, output: int) -> Iterator[FloatArray]:
    """(N, 5) per segment: what the free run leaves; its slope times the time from the middle of the flight,
    its slope, itself, and a constant."""
    flights = _flights(data)
    for s in data.segments:
        if len(s) <= 2 * model.n_init:
            continue
        run = model.simulate(s.u, s.y)[:, output]
        time_s = 1e-9 * s.t0_ns + data.dt_s * np.arange(len(s)) - np.mean(flights[s.flight])
        slope = np.gradient(run, data.dt_s)
        rows = np.column_stack([s.y[:, output] - run, slope * time_s, slope, run, np.ones(len(s))])
        yield rows[model.n_init :]
