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
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.lagged import lagged_gram

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
"""Rows of the regression; more tell nothing new."""
EVEN = 2.0 / 3.0
"""Share of the pauses between changes of an input that are of one length where the log holds its samples."""
SMALLEST = 1e-6
"""Of the regressors' size: smaller directions do not count, and what they explain is left."""


@dataclass(frozen=True)
class Feedback:
    """Whether the inputs answer one output.

    Attributes
    ----------
    p_value : of the F test; 1 where there are too few samples.
    share : what later inputs explain of the output's variance that nothing before did.
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
        return self.p_value < 1e-4 and self.share > 0.02

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


def feedback(data: Dataset) -> tuple[Feedback, ...]:
    """One answer per output. Segments too short for the test are left out.

    Examples
    --------
    >>> feedback(train)[0].closed  # train: see `flysid.Dataset`
    False
    """
    every = max(int(GRID_S / data.dt_s + 1e-6), _held([s.u for s in data.segments]))
    dt_s = every * data.dt_s
    lags = _look_ahead(dt_s)
    parts = _scale(data, every, ORDER + 6 * lags)
    gram = lagged_gram(enumerate(parts), ORDER + lags)
    names = tuple(s.name for s in data.inputs)
    found = []
    for j, output in enumerate(data.outputs):
        p, share = _later_inputs(gram, _columns(data, j, lags), lags) if parts else (1.0, 0.0)
        found.append(Feedback(output.name, names, p, share, lags * dt_s))
    return tuple(found)


def _look_ahead(dt_s: float, *, look_s: float = 1.0, fewest: int = 5, most: int = 25) -> int:
    """How many samples ahead an answer is looked for."""
    return int(np.clip(round(look_s / dt_s), fewest, most))


def _columns(data: Dataset, output: int, lags: int) -> tuple[list[int], list[int], int]:
    """Of the Gram: a constant, an output's past and inputs up to the next; later inputs; the output."""
    step = ORDER + lags + 1
    now = output * step + lags
    inputs = [(len(data.outputs) + i) * step + lags for i in range(len(data.inputs))]
    driven = [at + k for at in inputs for k in range(-1, ORDER + 1)]
    later = [at - k for at in inputs for k in range(2, lags + 1)]
    return [-1, *range(now + 1, now + 1 + ORDER), *driven], later, now


def _later_inputs(
    gram: FloatArray, columns: tuple[list[int], list[int], int], lags: int
) -> tuple[float, float]:
    """(p of the F test, share of the variance) of later inputs in what an output's past does not tell."""
    from scipy.special import fdtrc

    before, after, target = columns
    rows = float(gram[-1, -1])
    others = [*after, target]
    inner = gram[np.ix_(before, before)]
    known = _orthonormal(inner, gram[np.ix_(before, others)], float(np.trace(inner)))
    rest = gram[np.ix_(others, others)] - known.T @ known
    extra = _orthonormal(rest[:-1, :-1], rest[:-1, -1:], float(gram.diagonal()[after].sum()))
    gain = float(np.sum(extra**2))
    total = float(rest[-1, -1])
    added = len(extra)
    freedom = rows - len(known) - added
    if freedom < 2 * lags or not added or not total > SMALLEST**2 * rows:
        return 1.0, 0.0
    ratio = (gain / added) / max((total - gain) / freedom, 1e-300)
    # what chance explains on average is taken off the share
    share = max(gain / total - added / (freedom + added), 0.0)
    return float(fdtrc(added, freedom, ratio)), share


def _orthonormal(gram: FloatArray, products: FloatArray, size: float) -> FloatArray:
    """(rank, m) products of columns, made orthonormal, with m others; directions below SMALLEST do not count.

    Parameters
    ----------
    gram, products : (n, n) of the columns with each other; (n, m) with the others.
    size : sum of squares that SMALLEST is relative to.
    """
    from scipy.linalg.lapack import dpstrf, dtrtrs

    triangle, order, rank, _ = dpstrf(gram, tol=SMALLEST**2 * size)
    found: FloatArray = dtrtrs(triangle[:rank, :rank], products[order[:rank] - 1], trans=1)[0]
    return found


def _scale(data: Dataset, every: int, fewest: int) -> list[FloatArray]:
    """(n_y + n_u, N) outputs and inputs of segments of at least `fewest` rows, of mean 0 and variance 1.

    As many as rows are kept, of one sample in `every`, where inputs are new.
    """
    parts = []
    left = MOST_ROWS
    for s in data.segments:
        first = _first_new(s.u, every)
        part = np.hstack([s.y[first::every], s.u[first::every]])[:left].T
        if part.shape[1] >= fewest:
            parts.append(part)
            left -= part.shape[1]
    if not parts:
        return []
    signals = np.concatenate(parts, axis=1)
    mean = signals.mean(axis=1)[:, None]
    spread = signals.std(axis=1)[:, None]
    return [np.ascontiguousarray((part - mean) / np.where(spread > 0.0, spread, 1.0)) for part in parts]


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
