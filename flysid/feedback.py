"""Is a loop closed around a channel? Does the input answer what no past sample could foretell?

The test of Sims (1972, American Economic Review 62; Caines & Chan, 1975, IEEE Trans. Automatic Control 20):
an output is regressed on its own past and on past and present inputs, with and without the inputs of the next
second. In open loop later inputs explain nothing, whatever the input looks like; an F test decides. Where a
pilot or a controller answers the output, later inputs hold what was new in it. Long regressions stand for any
plant and any colour of the noise (Ljung, 1999, 13.4); what they miss of a nonlinear plant can fake a little,
so that a share of the variance is required, too.

The very next input counts as known: a vehicle moves between the samples of a log, too, and what is logged
next helps to tell what its input did there. So a controller of no memory that answers within a sample goes
unseen.
Samples are taken where the input is new: one that the log holds for five samples gives every fifth. Between,
it is no more than an old number, and what the vehicle answers there looks like foresight. Of faster logs
samples 20 ms apart are taken: a pilot and an outer loop need longer.

A sample behind the loader's low-pass (`flysid.dataset.LOWPASS`) stands for what lies to both sides of it.
Such an input is no stair: what it is between two samples follows from samples before and after, and counts
as known. Near half the grid's rate the low-pass lets higher frequencies pass as lower ones, so later inputs
count without what lies there. What is left of the output below the filter's own errors says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import LOWPASS, LOWPASS_BETA, Dataset, FloatArray
from flysid.errors import UsageError

BIASED = "Free-run fits (OE, TF, refined ARX) may be biased"
REMEDY = (
    "compare with ARMAX or BJ (prediction error), or IV with the reference as instrument, or excite the "
    "command far above the controller's own activity"
)
ORDER = 20
"""Past samples that the regression knows."""
GRID_S = 0.02
"""Samples are not taken closer together."""
MOST_ROWS = 50_000
"""Rows of the regression; more take memory and tell nothing new."""
EVEN = 2.0 / 3.0
"""Share of the pauses between changes of an input that are of one length where the log holds its samples."""
HALFWAY = np.sinc(np.arange(-24.5, 25.0)) * np.kaiser(50, 5.0)
"""(50,) taps that give a smooth input half a sample earlier."""
SLOW = 0.5 * np.sinc(0.5 * np.arange(-12.0, 13.0)) * np.kaiser(25, 5.0)
"""(25,) taps of a low-pass that has faded where the loader's falls to a half, at 0.4 of the grid's rate."""
SMALLEST = 1e-6
"""Of the largest direction of the regressors: smaller ones do not count, and what they explain is left."""


@dataclass(frozen=True)
class Feedback:
    """Whether the inputs answer one output.

    `p_value`: of the F test; 1 where there are too few samples.
    `share`: what later inputs explain of the output's variance that nothing before did.
    `look_s`: how far ahead the later inputs were.
    `matters`: the share above which a loop is called closed.
    """

    output: str
    inputs: tuple[str, ...]
    p_value: float
    share: float
    look_s: float
    matters: float

    @property
    def closed(self) -> bool:
        """A loop is closed, beyond doubt and by a margin that matters."""
        return self.p_value < 1e-4 and self.share > self.matters

    @property
    def seen(self) -> str:
        """What was seen; "" in open loop."""
        if not self.closed:
            return ""
        return (
            f"{' and '.join(self.inputs)} react{'s' if len(self.inputs) == 1 else ''} to {self.output}: "
            f"within {self.look_s:.2g} s after, {100 * self.share:.0f} % of what could not be predicted "
            "appears in the input, so a loop is closed around it."
        )

    @property
    def words(self) -> str:
        """What was seen and what to do; "" in open loop."""
        return f"{self.seen} {BIASED}: {REMEDY}." if self.closed else ""


def feedback(data: Dataset, *, matters: float = 0.02, passed: float = 0.5) -> tuple[Feedback, ...]:
    """One answer per output. Segments too short for the test are left out.

    `matters`: share of the output's variance, 0 to 1, from which an answer of the inputs counts as a loop.
    `passed`: what the loader's low-pass leaves of such an answer; behind it `matters` is that much less. An
        AR.Drone under a position controller shows 1.7 and 1.9 %, and 3.0 and 5.4 % if the low-pass is not
        accounted for; of 56 merged tables without a loop two are above 1 % beyond doubt, two above 2 %.
    Raises UsageError: a share that is none.

    >>> feedback(train)[0].closed  # train: see `flysid.Dataset`
    False
    """
    for name, share in (("matters", matters), ("passed", passed)):
        if not 0.0 < share <= 1.0:
            raise UsageError(f"{name} is {share:g}", hint="a share above 0, at most 1")
    every = max(int(GRID_S / data.dt_s + 1e-6), _held([s.u for s in data.segments]))
    dt_s = every * data.dt_s
    lags = _look_ahead(dt_s)
    names = tuple(s.name for s in data.inputs)
    is_smooth = any(s.marks.get(LOWPASS) for s in data.segments)
    found = []
    for j, output in enumerate(data.outputs):
        signals = _scale(data, j, every, ORDER + 6 * lags)
        rows = [_rows(y, u, lags, every, is_smooth=is_smooth) for y, u in signals]
        p, share = _later_inputs(rows, lags, _leak() if is_smooth else SMALLEST)
        least = passed * matters if is_smooth else matters
        found.append(Feedback(output.name, names, p, share, lags * dt_s, least))
    return tuple(found)


def _leak() -> float:
    """Of the output's spread: what the loader's low-pass leaves of what it should stop (Kaiser, 1974)."""
    return float(10.0 ** (-(LOWPASS_BETA / 0.1102 + 8.7) / 20.0))


def _look_ahead(dt_s: float, *, look_s: float = 1.0, fewest: int = 5, most: int = 25) -> int:
    """How many samples ahead an answer is looked for."""
    return int(np.clip(round(look_s / dt_s), fewest, most))


def _later_inputs(
    rows: list[tuple[FloatArray, FloatArray, FloatArray]], lags: int, floor: float
) -> tuple[float, float]:
    """(p of the F test, share of the variance) of later inputs in what an output's past does not tell.

    `rows`: of `_rows`, segment by segment.
    `floor`: of the output's spread; where less than this cannot be known from the past, nothing is tested.
    """
    from scipy.special import fdtrc

    if not rows:
        return 1.0, 0.0
    target, before, after = (np.concatenate(parts)[:MOST_ROWS] for parts in zip(*rows, strict=True))
    known, kept = _basis(before)
    rest = target - known @ (known.T @ target)
    extra, added = _basis(after - known @ (known.T @ after), float(np.linalg.norm(after)))
    gain = float(np.sum((extra.T @ rest) ** 2))
    total = float(rest @ rest)
    freedom = len(target) - kept - added
    if freedom < 2 * lags or not added or not total > floor**2 * len(target):
        return 1.0, 0.0
    ratio = (gain / added) / max((total - gain) / freedom, 1e-300)
    # what chance explains on average is taken off the share
    share = max(gain / total - added / (freedom + added), 0.0)
    return float(fdtrc(added, freedom, ratio)), share


def _scale(data: Dataset, output: int, every: int, fewest: int) -> list[tuple[FloatArray, FloatArray]]:
    """(N,) output and (N, n_u) inputs of segments of at least `fewest` rows, of mean 0 and variance 1.

    As many as rows are kept, each from the first of `every` samples at which inputs are new.
    """
    parts = []
    left = MOST_ROWS
    for s in data.segments:
        first = _first_new(s.u, every)
        part = np.column_stack([s.y[first:, output], s.u[first:]])
        rows = -(-len(part) // every)
        if rows >= fewest and left > 0:
            parts.append(part)
            left -= rows
    if not parts:
        return []
    taken = np.concatenate([part[::every] for part in parts])
    mean, spread = taken.mean(axis=0), taken.std(axis=0)
    scaled = [(part - mean) / np.where(spread > 0.0, spread, 1.0) for part in parts]
    return [(part[:, 0], part[:, 1:]) for part in scaled]


def _held(inputs: list[FloatArray]) -> int:
    """For how many samples the log holds the input that changes least often, at least 1.

    1 where changes come at uneven times: a command that waits is no sample that is held.
    """
    pauses = [
        np.concatenate([np.diff(np.flatnonzero(np.diff(u[:, i]) != 0.0)) for u in inputs])
        for i in range(inputs[0].shape[1])
    ]
    held = [(float(np.median(p)), p) for p in pauses if len(p)]
    longest, lengths = max(held, key=lambda one: one[0], default=(1.0, np.ones(1)))
    even = np.abs(lengths - longest) <= 1.0
    return max(int(longest + 0.5), 1) if np.mean(even) > EVEN else 1


def _first_new(u: FloatArray, every: int) -> int:
    """The first of every so many samples at which most inputs (N, n_u) are new."""
    new = np.flatnonzero((np.diff(u, axis=0) != 0.0).any(axis=1)) + 1
    return int(np.bincount(new % every, minlength=every).argmax())


def _rows(
    y: FloatArray, u: FloatArray, lags: int, every: int, *, is_smooth: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Output, what is known of it (a constant, its past, inputs up to the next), later inputs.

    Of one sample in `every`; of a smooth input those between are known, too.
    """
    at = np.arange(ORDER * every, len(y) - lags * every, every)
    known = [np.ones((len(at), 1)), *(y[at - every * k, None] for k in range(1, ORDER + 1))]
    known += [u[at + k] for k in range(-ORDER * every, every + 1, 1 if is_smooth else every)]
    if is_smooth:
        halfway = _filter(u, HALFWAY)
        known += [halfway[at + k] for k in range(-1, every + 2)]
        u = _filter(u, SLOW)
    return y[at], np.hstack(known), np.hstack([u[at + every * k] for k in range(2, lags + 1)])


def _filter(u: FloatArray, taps: FloatArray) -> FloatArray:
    """(N, n_u) every column through taps that lie around each sample, or half a sample before it."""
    return np.stack([np.convolve(column, taps, mode="same") for column in u.T], axis=1)


def _basis(columns: FloatArray, size: float | None = None) -> tuple[FloatArray, int]:
    """Orthonormal basis of the columns' range, and its dimension; directions below SMALLEST do not count."""
    q, r = np.linalg.qr(columns)  # first, as columns are long: of the triangle the decomposition is cheap
    left, sigma, _ = np.linalg.svd(r, full_matrices=False)
    rank = int(np.count_nonzero(sigma > SMALLEST * (sigma[0] if size is None else size)))
    return q @ left[:, :rank], rank
