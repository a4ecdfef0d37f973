"""Is a held-out flight one of the training flights? Copies are found by content, whatever their names.

Three tests, the quick one first:

1. Windows of 16 rows, rounded to a thousandth of each signal's standard deviation, are hashed and looked
   up: the same samples on the same grid, all at one lag, also where two formats round them differently.
2. What a linear model of inputs and past outputs leaves, e, is correlated between flights over all lags. One
   flight recorded twice, at other rates or by formats that round coarsely, shares its noise and its wind,
   so that e agrees wherever the two overlap. Two flights of the same plan do not, however alike their
   outputs are: such repeats are fresh evidence, and are kept.
3. Outputs that agree to within 2 % of their spread over half a flight, at the lag that suits them best: a
   repeat with so little noise teaches nothing that the first did not, recorded twice or flown twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from flysid.stretch import FloatArray, Stretch

if TYPE_CHECKING:
    from flysid.leakage.alike import Grid  # compiled code: only where flights are compared

Hashes = npt.NDArray[np.uint64]
Indices = npt.NDArray[np.int64]

COPY_ROWS = 16  # rows that must agree to count as copied
COPY_ROUNDING = 1e-3  # of a signal's standard deviation
COPY_SHARE = 0.2  # of a flight that is found in another: the two overlap
COPY_STEPS = 10  # changes of an output in what is found: standing still, all flights agree
COPY_WHOLE = 0.9  # of a flight: where all of it agrees, it need not change so often
MAX_HASHES = 1_000_000
LAGS = 10  # past outputs and inputs of the linear model whose remainder is compared
FIT_ROWS = 50_000  # at most, of all flights together, to fit that model
LONGEST_PAUSE = 1000  # samples: longer pauses are shortened, so that a day between two boots costs no memory


@dataclass(frozen=True)
class Copy:
    """A held-out flight that repeats a training flight, and the evidence."""

    held_out: str
    training: str
    how: str


def find_copy(train: Sequence[Stretch], test: Sequence[Stretch], dt_s: float) -> Copy | None:
    """The first held-out flight that repeats or overlaps a training flight of another name, or None.

    `train`, `test`: samples of both parts; pieces of one flight may be in both.
    """
    train, test = ([s for s in part if len(s.y)] for part in (train, test))
    if not train or not test or len({s.flight for s in (*train, *test)}) < 2:
        return None
    return _same_samples(train, test) or _same_flight(train, test, dt_s)


# ------------------------------------------------------------------------------------- equal samples


@dataclass(frozen=True, eq=False)
class _Windows:
    """Every COPY_ROWS rows of some flights that are not all alike, in the order of their hashes.

    `hashes`, `flight`, `row`: (n,) of every window: hash, number of its flight, its first row in that flight.
    `counts`: (flights,) how many windows each flight has.
    `steps`: per flight the rows, rising, at which an output changes.
    """

    hashes: Hashes
    flight: Indices
    row: Indices
    counts: Indices
    steps: Mapping[int, Indices]


def _same_samples(train: Sequence[Stretch], test: Sequence[Stretch]) -> Copy | None:
    """Windows of a held-out flight that stand in one training flight, all moved by the same number of rows.

    A window may be alike by chance, where signals are coarse or the vehicle stands; many at one lag are
    not. What stands still in both shows nothing: some outputs must change, or all of the flight must agree.
    """
    names = list(dict.fromkeys(s.flight for s in (*train, *test)))
    both = [*train, *test]
    step = _rounding(both)
    thin = max(1, sum(len(s.y) for s in both) // MAX_HASHES)
    known, held = (_windows(part, names, step, thin) for part in (train, test))
    if len(known.hashes) == 0 or len(held.hashes) == 0:
        return None
    at = np.minimum(np.searchsorted(known.hashes, held.hashes), len(known.hashes) - 1)
    copied = (known.hashes[at] == held.hashes) & (known.flight[at] != held.flight)
    found = np.stack([held.flight, known.flight[at], known.row[at] - held.row], axis=1)[copied]
    rows = held.row[copied]
    groups, of, sizes = np.unique(found, axis=0, return_inverse=True, return_counts=True)
    for i in np.argsort(-sizes, kind="stable"):
        mine, theirs, _ = groups[i]
        share = sizes[i] / held.counts[mine]
        if share <= COPY_SHARE:
            continue
        seen = np.unique(rows[of.ravel() == i][:, None] + np.arange(1, COPY_ROWS))
        changes = len(np.intersect1d(seen, held.steps[mine]))
        if changes >= COPY_STEPS or (share > COPY_WHOLE and changes):
            return Copy(
                names[mine], names[theirs], f"{100.0 * min(share, 1.0):.0f} % of its samples are the same"
            )
    return None


def _windows(stretches: Sequence[Stretch], names: Sequence[str], step: FloatArray, thin: int) -> _Windows:
    """All windows; of many millions, the same sample of hashes is taken."""
    number = {name: i for i, name in enumerate(names)}
    counts = np.zeros(len(names), dtype=np.int64)
    length = dict.fromkeys(names, 0)
    parts: list[tuple[Hashes, Indices, Indices]] = []
    steps: dict[int, list[Indices]] = {i: [] for i in range(len(names))}
    for s in stretches:
        flight = number[s.flight]
        first = length[s.flight]
        hashes, rows = _row_hashes(s, step)
        kept = hashes % np.uint64(thin) == 0
        counts[flight] += int(kept.sum())
        parts.append((hashes[kept], np.full(int(kept.sum()), flight), first + rows[kept]))
        changed = np.flatnonzero((np.diff(np.rint(s.y / step[-s.y.shape[1] :]), axis=0) != 0).any(axis=1))
        steps[flight].append(first + 1 + changed)
        length[s.flight] += len(s.y)
    joined, flights, at = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(joined, kind="stable")
    found = {i: np.concatenate(own) for i, own in steps.items() if own}
    return _Windows(joined[order], flights[order], at[order], counts, found)


def _rounding(stretches: Sequence[Stretch]) -> FloatArray:
    """(n_u + n_y,) a thousandth of each signal's standard deviation over all stretches; 1 where it is 0."""
    count = sum(len(s.y) for s in stretches)
    mean = np.zeros(stretches[0].u.shape[1] + stretches[0].y.shape[1])
    squares = np.zeros_like(mean)
    for s in stretches:
        mean += np.concatenate([s.u.sum(axis=0), s.y.sum(axis=0)]) / count
    for s in stretches:
        squares += ((np.concatenate([s.u, s.y], axis=1) - mean) ** 2).sum(axis=0)
    step = COPY_ROUNDING * np.sqrt(squares / count)
    return np.asarray(np.where(step > 0, step, 1.0), dtype=np.float64)


def _row_hashes(stretch: Stretch, step: FloatArray) -> tuple[Hashes, Indices]:
    """Hash and first row of every COPY_ROWS rows that are not all alike; the order of rows counts."""
    rows = np.concatenate([stretch.u, stretch.y], axis=1)
    if len(rows) < COPY_ROWS:
        return np.empty(0, dtype=np.uint64), np.empty(0, dtype=np.int64)
    words = np.ascontiguousarray(np.rint(rows / step).astype(np.int64)).view(np.uint64)
    keys = np.random.default_rng(20).integers(1, 1 << 63, size=(COPY_ROWS, rows.shape[1]), dtype=np.uint64)
    mixed = np.zeros(len(rows) - COPY_ROWS + 1, dtype=np.uint64)
    for i in range(COPY_ROWS):
        part = words[i : len(words) - COPY_ROWS + 1 + i]
        folded = (part ^ (part >> np.uint64(29))) * (keys[i] | np.uint64(1))
        mixed += (folded ^ (folded >> np.uint64(32))).sum(axis=1, dtype=np.uint64)
    changes = (np.diff(words, axis=0) != 0).any(axis=1)
    alive = np.flatnonzero(np.convolve(changes, np.ones(COPY_ROWS - 1, dtype=int), mode="valid"))
    return mixed[alive], alive


# ---------------------------------------------------------------------------------------- equal noise


def _same_flight(train: Sequence[Stretch], test: Sequence[Stretch], dt_s: float) -> Copy | None:
    """Tests 2 and 3."""
    from flysid.leakage.same_flights import same_flights

    theta = _linear_model([*train, *test])
    known, held = (_on_grids(part, theta, dt_s) for part in (train, test))
    names, others = list(held), list(known)
    for i, k, how in same_flights(list(known.values()), list(held.values())):
        if others[k] != names[i]:
            return Copy(names[i], others[k], how)
    return None


def _equations(s: Stretch, rows: int) -> FloatArray:
    """(rows, n_y LAGS + n_u (LAGS + 1) + 1 + n_y) past outputs, present and past inputs, a constant, outputs.

    Of the middle of a flight: at its start a vehicle stands, or only begins to move.
    """
    first = (len(s.y) - LAGS - rows) // 2
    ones = np.ones((rows, 1))
    return np.concatenate([*_lag(s, rows, first), ones, s.y[first + LAGS :][:rows]], axis=1)


def _lag(s: Stretch, rows: int, first: int = 0) -> list[FloatArray]:
    start = first + LAGS
    past = [s.y[start - lag : start - lag + rows] for lag in range(1, LAGS + 1)]
    return past + [s.u[start - lag : start - lag + rows] for lag in range(LAGS + 1)]


def _left(s: Stretch, theta: FloatArray) -> FloatArray:
    """(N - LAGS, n_y) what the model leaves; no regressors of a long flight are laid out for it."""
    left = s.y[LAGS:] - theta[-1]
    first = 0
    for signal in _lag(s, len(left)):
        left -= signal @ theta[first : first + signal.shape[1]]
        first += signal.shape[1]
    return np.asarray(left)


def _linear_model(stretches: Sequence[Stretch]) -> FloatArray | None:
    """(columns, n_y) one-step least squares over some of all flights alike; None without enough samples."""
    usable = [s for s in stretches if len(s.y) > 3 * LAGS]
    each = FIT_ROWS // max(len(usable), 1)
    gram: FloatArray | None = None
    for s in usable:
        both = _equations(s, min(max(each, 1), len(s.y) - LAGS))
        product = both.T @ both
        gram = product if gram is None else gram + product
    if gram is None:
        return None
    n_y = usable[0].y.shape[1]
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(scale, scale)
    theta = np.linalg.lstsq(scaled[:-n_y, :-n_y], scaled[:-n_y, -n_y:], rcond=1e-10)[0]
    return np.asarray(theta * scale[-n_y:] / scale[:-n_y, None])


def _on_grids(stretches: Sequence[Stretch], theta: FloatArray | None, dt_s: float) -> dict[str, Grid]:
    flights: dict[str, list[Stretch]] = {}
    for s in stretches:
        flights.setdefault(s.flight, []).append(s)
    return {name: _on_grid(own, theta, dt_s) for name, own in flights.items()}


def _on_grid(stretches: Sequence[Stretch], theta: FloatArray | None, dt_s: float) -> Grid:
    from flysid.leakage.alike import Grid

    ordered = sorted(stretches, key=lambda s: s.t0_ns)
    starts = []
    stop = 0
    end_ns = ordered[0].t0_ns
    for s in ordered:
        pause = max(0, round((s.t0_ns - end_ns) * 1e-9 / dt_s))
        starts.append(stop + min(pause, LONGEST_PAUSE))
        stop = starts[-1] + len(s.y)
        end_ns = s.t0_ns + round(len(s.y) * dt_s * 1e9)
    n_u = ordered[0].u.shape[1]
    n_y = ordered[0].y.shape[1]
    u, y, e = (np.full((stop, n), np.nan) for n in (n_u, n_y, n_y))
    moving = [np.flatnonzero(_moving(s.y)) for s in ordered]  # on the ground all flights agree
    for start, s, rows in zip(starts, ordered, moving, strict=True):
        u[start + rows], y[start + rows] = s.u[rows], s.y[rows]
    long = [k for k, s in enumerate(ordered) if theta is not None and len(s.y) > 3 * LAGS]
    if theta is None or not long:
        return Grid(u, y, e)
    left = [_left(ordered[k], theta) for k in long]
    white = _whitener(left)
    for k, rest in zip(long, left, strict=True):
        rows = moving[k][moving[k] >= 2 * LAGS]
        e[starts[k] + rows] = _whiten(rest, white)[rows - 2 * LAGS]
    known = e[np.isfinite(e[:, 0])]
    return Grid(u, y, np.clip(e, *_bounds(known)) if len(known) else e)


def _moving(y: FloatArray) -> npt.NDArray[np.bool_]:
    """(N,) whether some output changed within the last samples."""
    steps = np.concatenate([[0], np.cumsum((np.diff(y, axis=0) != 0).any(axis=1))])
    before = np.concatenate([np.zeros(LAGS, dtype=steps.dtype), steps])[: len(steps)]
    return np.asarray(steps > before)


def _whitener(parts: Sequence[FloatArray]) -> FloatArray:
    """(LAGS, n_y) autoregression of each column: what is slow in a remainder is bent dynamics, not noise."""
    columns = []
    for j in range(parts[0].shape[1]):
        gram = np.zeros((LAGS + 1, LAGS + 1))
        for part in parts:
            shifted = _shift(part[:, j])
            gram += [[a @ b for a in shifted] for b in shifted]
        ridge = (1e-6 * np.trace(gram[1:, 1:]) / LAGS + 1e-300) * np.eye(LAGS)
        columns.append(np.linalg.solve(gram[1:, 1:] + ridge, gram[1:, 0]))
    return np.stack(columns, axis=1)


def _whiten(e: FloatArray, white: FloatArray) -> FloatArray:
    found = e[LAGS:].copy()
    for j in range(e.shape[1]):
        for past, weight in zip(_shift(e[:, j])[1:], white[:, j], strict=True):
            found[:, j] -= weight * past
    return found


def _shift(x: FloatArray) -> list[FloatArray]:
    """(N - LAGS,) the samples from the LAGS-th on, and those one to LAGS before each."""
    return [x[LAGS - lag : len(x) - lag] for lag in range(LAGS + 1)]


def _bounds(e: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Five robust standard deviations about the median: one jump must not decide a correlation."""
    middle = np.median(e, axis=0)
    reach = 5.0 * 1.4826 * np.median(np.abs(e - middle), axis=0)
    return middle - reach, middle + reach
