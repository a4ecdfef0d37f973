"""Is a loop closed around the model? Does the input answer what the model could not know?

Noise that has come back through a controller shows in later inputs. The test of Sims (1972, American Economic
Review 62; Caines & Chan, 1975, IEEE Trans. Automatic Control 20) on what a model's free run leaves over: that
is whitened, inputs are filtered alike, and then regressed on past and present inputs, with and without the
inputs of the next second. In open loop later inputs explain nothing, whatever the input looks like; an F test
tells. A model that misses slow dynamics can fake a little, so that a share of the variance is asked for too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.filters import filtered
from flysid.model.base import Fitted
from flysid.model.noise import noise_model
from flysid.model.start import run_from_window, start_window

BIASED = "Free-run fits (OE, TF, refined ARX) may be biased"
REMEDY = (
    "compare with ARMAX or BJ (prediction error), or IV with the reference as instrument, or excite the "
    "command far above the controller's own activity"
)


@dataclass(frozen=True)
class Feedback:
    """Whether the inputs answer one output.

    Attributes
    ----------
    p_value : of the F test; 1 where there are too few samples.
    share : of the variance of the model's innovations that later inputs explain.
    look_s : how far ahead the later inputs were.
    """

    output: str
    inputs: tuple[str, ...]
    p_value: float
    share: float
    look_s: float

    @property
    def closed(self) -> bool:
        """A loop is closed, beyond doubt and by a margin that matters."""
        return is_closed(self.p_value, self.share)

    @property
    def seen(self) -> str:
        """What was seen; "" in open loop."""
        if not self.closed:
            return ""
        return (
            f"{' and '.join(self.inputs)} react{'s' if len(self.inputs) == 1 else ''} to {self.output}: "
            f"within {self.look_s:.2g} s after, {100 * self.share:.0f} % of what the model could not predict "
            "appears in the input, so a loop is closed around it."
        )

    @property
    def words(self) -> str:
        """What was seen and what to do; "" in open loop."""
        return f"{self.seen} {BIASED}: {REMEDY}." if self.closed else ""


def is_closed(p_value: float, share: float, level: float = 1e-4, least_share: float = 0.02) -> bool:
    """Whether later inputs explain the innovations beyond doubt, and enough of their variance to matter."""
    return p_value < level and share > least_share


def answer_lags(dt_s: float, *, look_s: float = 1.0, fewest: int = 5, most: int = 25) -> int:
    """How many samples ahead an answer is looked for."""
    return int(np.clip(round(look_s / dt_s), fewest, most))


def feedback(model: Fitted, data: Dataset) -> tuple[Feedback, ...]:
    """One answer per output; the model should be a good linear one, the data those it was fitted to.

    Segments too short for the test are left out.
    """
    lags = answer_lags(data.dt_s)
    names = tuple(s.name for s in data.inputs)
    left = _left_over(model, data, lags)
    found = []
    for j, output in enumerate(data.outputs):
        p, share = later_inputs([e[:, j] for e, _ in left], [u for _, u in left], lags)
        found.append(Feedback(output.name, names, p, share, lags * data.dt_s))
    return tuple(found)


def _left_over(model: Fitted, data: Dataset, lags: int) -> list[tuple[FloatArray, FloatArray]]:
    """(errors of the free run, inputs) per segment that is long enough, without its start."""
    found = []
    for segment in data.segments:
        skip = start_window(model.n_init, len(segment), data.dt_s)
        if len(segment) < skip + 6 * lags:
            continue
        error = (segment.y - run_from_window(model, segment, skip))[skip:]
        if np.isfinite(error).all():
            found.append((error, segment.u[skip:]))
    return found


def later_inputs(
    errors: Sequence[FloatArray], inputs: Sequence[FloatArray], lags: int
) -> tuple[float, float]:
    """(p of the F test, share of the variance) of later inputs in the whitened errors of segments."""
    from scipy.special import fdtrc

    if not errors or not any(float(np.ptp(e)) > 0.0 for e in errors):
        return 1.0, 0.0
    d, _ = noise_model(errors)
    targets = []
    past = []
    later = []
    for error, u in zip(errors, inputs, strict=True):
        e = filtered(d, np.ones(1), error)
        v = filtered(d, np.ones(1), u - u.mean(axis=0))
        rows = np.arange(lags + len(d), len(e) - lags)
        targets.append(e[rows])
        past.append(np.hstack([v[rows - k] for k in range(lags + 1)]))
        later.append(np.hstack([v[rows + k] for k in range(1, lags + 1)]))
    y = np.concatenate(targets)
    before = np.column_stack([np.ones(sum(map(len, targets))), np.concatenate(past)])
    q, kept = _basis(before)
    rest = y - q @ (q.T @ y)
    after = np.concatenate(later)
    extra, added = _basis(after - q @ (q.T @ after), float(np.linalg.norm(after)))
    gain = float(np.sum((extra.T @ rest) ** 2))
    total = float(rest @ rest)
    freedom = len(y) - kept - added
    if freedom < 2 * lags or not added or not total > 0.0:
        return 1.0, 0.0
    ratio = (gain / added) / max((total - gain) / freedom, 1e-300)
    # what chance explains on average is taken off the share
    share = max(gain / total - added / (freedom + added), 0.0)
    return float(fdtrc(added, freedom, ratio)), share


def _basis(columns: FloatArray, size: float | None = None) -> tuple[FloatArray, int]:
    """Orthonormal basis of the columns' range, and its dimension; directions below 1e-6 do not count."""
    q, r = np.linalg.qr(columns)  # first, as columns are long: of the triangle the decomposition is cheap
    left, sigma, _ = np.linalg.svd(r, full_matrices=False)
    rank = int(np.count_nonzero(sigma > 1e-6 * (sigma[0] if size is None else size)))
    return q @ left[:, :rank], rank
