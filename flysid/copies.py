"""Is a held-out flight one of the training flights? Copies are found by content, whatever their names.

Three tests, the quick one first:

1. Stretches of 16 rows, rounded to a thousandth of each signal's standard deviation, are hashed and looked
   up: the same samples on the same grid, also where two formats round them differently.
2. What a linear model of inputs and past outputs leaves, e, is correlated between flights over all lags. One
   flight recorded twice, at other rates or by formats that round coarsely, shares its noise and its wind,
   so that e agrees wherever the two overlap. Two flights of the same plan do not, however alike their
   outputs are: such repeats are fresh evidence, and are kept.
3. Outputs that agree to within 2 % of their spread over half a flight, at the lag that suits them best: a
   repeat with so little noise teaches nothing that the first did not, recorded twice or flown twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.stretch import FloatArray, Stretch

Hashes = npt.NDArray[np.uint64]

COPY_ROWS = 16  # rows that must agree to count as copied
COPY_ROUNDING = 1e-3  # of a signal's standard deviation
COPY_SHARE = 0.2  # of a flight that is found in another: the two overlap
MAX_HASHES = 1_000_000
LAGS = 10  # past outputs and inputs of the linear model whose remainder is compared
FIT_ROWS = 50_000  # at most, of all flights together, to fit that model
LEAST_OVERLAP = 100  # samples
LEAST_CORRELATION = (
    0.3  # of the remainders of two recordings of one flight, at rates that differ by up to ten
)
SAME_OUTPUT = 0.02  # of its spread
SAME_SHARE = 0.5  # of a flight whose outputs agree so well
FRACTIONS = 9  # lags tried between two samples
SIGMAS = 8.0  # chance reaches about 5 over the lags of the longest flights
LONGEST_PAUSE = 1000  # samples: longer pauses are shortened, so that a day between two boots costs no memory


@dataclass(frozen=True)
class Copy:
    """A held-out flight that repeats a training flight, and how that shows."""

    held_out: str
    training: str
    how: str


def find_copy(train: Sequence[Stretch], test: Sequence[Stretch], dt_s: float) -> Copy | None:
    """The first held-out flight that repeats or overlaps a training flight of another name, or None.

    Parameters
    ----------
    train, test : samples of both parts; pieces of one flight may be in both.
    """
    if len({s.flight for s in (*train, *test)}) < 2:
        return None
    return _same_samples(train, test) or _same_flight(train, test, dt_s)


# ------------------------------------------------------------------------------------- equal samples


def _same_samples(train: Sequence[Stretch], test: Sequence[Stretch]) -> Copy | None:
    """Stretches in which an output mostly stands still count for nothing: on the ground all flights agree."""
    names = list(dict.fromkeys(s.flight for s in (*train, *test)))
    both = [*train, *test]
    step, thin = _rounding(both), max(1, sum(len(s.y) for s in both) // MAX_HASHES)
    known, owners = _hashed(train, names, step, thin)
    held, holders = _hashed(test, names, step, thin)
    if len(known) == 0 or len(held) == 0:
        return None
    at = np.minimum(np.searchsorted(known, held), len(known) - 1)
    copied = (known[at] == held) & (owners[at] != holders)
    for i in np.unique(holders[copied]).tolist():
        share = float(copied[holders == i].mean())
        if share > COPY_SHARE:
            other = int(np.bincount(owners[at][copied & (holders == i)]).argmax())
            return Copy(names[i], names[other], f"{share:.0%} of its samples are the same")
    return None


def _hashed(
    stretches: Sequence[Stretch], names: Sequence[str], step: FloatArray, thin: int
) -> tuple[Hashes, npt.NDArray[np.int64]]:
    """Sorted hashes, and the flight each is from. Of many millions, the same sample of hashes is taken."""
    number = {name: i for i, name in enumerate(names)}
    hashes: list[Hashes] = [np.empty(0, dtype=np.uint64)]
    owners: list[npt.NDArray[np.int64]] = [np.empty(0, dtype=np.int64)]
    for stretch in stretches:
        found = np.unique(_row_hashes(stretch, step))
        found = found[found % np.uint64(thin) == 0]
        hashes.append(found)
        owners.append(np.full(len(found), number[stretch.flight]))
    joined, of = np.concatenate(hashes), np.concatenate(owners)
    order = np.argsort(joined, kind="stable")
    return joined[order], of[order]


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


def _row_hashes(stretch: Stretch, step: FloatArray) -> Hashes:
    """Hashes of every COPY_ROWS rows that move; the order of rows counts."""
    rows = np.concatenate([stretch.u, stretch.y], axis=1)
    if len(rows) < COPY_ROWS:
        return np.empty(0, dtype=np.uint64)
    words = np.ascontiguousarray(np.rint(rows / step).astype(np.int64)).view(np.uint64)
    keys = np.random.default_rng(20).integers(1, 1 << 63, size=(COPY_ROWS, rows.shape[1]), dtype=np.uint64)
    mixed = np.zeros(len(rows) - COPY_ROWS + 1, dtype=np.uint64)
    for i in range(COPY_ROWS):
        part = words[i : len(words) - COPY_ROWS + 1 + i]
        folded = (part ^ (part >> np.uint64(29))) * (keys[i] | np.uint64(1))
        mixed += (folded ^ (folded >> np.uint64(32))).sum(axis=1, dtype=np.uint64)
    moves = (np.diff(stretch.y, axis=0) != 0).all(axis=1)
    count = np.convolve(moves, np.ones(COPY_ROWS - 1, dtype=int), mode="valid")
    return np.asarray(mixed[2 * count > COPY_ROWS])


# ---------------------------------------------------------------------------------------- equal noise


def _same_flight(train: Sequence[Stretch], test: Sequence[Stretch], dt_s: float) -> Copy | None:
    """Tests 2 and 3, flight by flight."""
    theta = _linear_model([*train, *test])
    if theta is None:
        return None
    known, held = (_on_grids(part, theta, dt_s) for part in (train, test))
    for name, mine in held.items():
        for other, theirs in known.items():
            how = "" if other == name else _same_noise(theirs, mine) or _same_output(theirs, mine)
            if how:
                return Copy(name, other, how)
    return None


@dataclass(frozen=True, eq=False)
class _Grid:
    """One flight on a grid of time: (N, n_y) outputs and what the model leaves of them, NaN in gaps."""

    y: FloatArray
    e: FloatArray

    @property
    def samples(self) -> int:
        return int(np.isfinite(self.e[:, 0]).sum())


def _same_noise(theirs: _Grid, mine: _Grid) -> str:
    """How two flights share their noise, or ''."""
    for a, b in zip(theirs.e.T, mine.e.T, strict=True):
        x, z = _overlapping(a, b, _best_lag(a, b))
        if len(x) < max(LEAST_OVERLAP, COPY_SHARE * mine.samples):
            continue
        x, z = x - x.mean(), z - z.mean()
        if not (x.any() and z.any()):
            continue
        x, z = x / np.abs(x).max(), z / np.abs(z).max()  # squares of tiny units would vanish
        rho = float(x @ z / np.sqrt((x @ x) * (z @ z)))
        if rho > LEAST_CORRELATION and rho * np.sqrt(len(x)) > SIGMAS:
            return f"its noise is the same over {len(x) / mine.samples:.0%} of it (correlation {rho:.2f})"
    return ""


def _same_output(theirs: _Grid, mine: _Grid) -> str:
    """How the outputs of two flights agree, or ''."""
    shares: list[float] = []
    if min(theirs.samples, mine.samples) < LEAST_OVERLAP:
        return ""
    for a, b in zip(theirs.y.T, mine.y.T, strict=True):
        lag, spread = _best_lag(a - np.nanmean(a), b - np.nanmean(b)), float(np.nanstd(b))
        x, z = _overlapping(a, b, lag)
        if len(x) < max(LEAST_OVERLAP, SAME_SHARE * mine.samples) or spread == 0.0:
            return ""
        if min(_apart(x, z, f) for f in np.linspace(-0.5, 0.5, FRACTIONS)) > SAME_OUTPUT * spread:
            return ""
        shares.append(len(x) / mine.samples)
    return f"its outputs are the same to within {SAME_OUTPUT:.0%} over {min(1.0, *shares, 1.0):.0%} of it"


def _apart(x: FloatArray, z: FloatArray, fraction: float) -> float:
    """RMS difference of two records, one moved by a fraction of a sample."""
    at = np.arange(1, len(x) - 1, dtype=np.float64)
    return float(np.sqrt(np.mean((x[1:-1] - np.interp(at + fraction, np.arange(len(z)), z)) ** 2)))


def _regressors(s: Stretch) -> FloatArray:
    """(N - LAGS, n_y LAGS + n_u (LAGS + 1) + 1) past outputs, present and past inputs, a constant."""
    rows = len(s.y) - LAGS
    past = [s.y[LAGS - lag : LAGS - lag + rows] for lag in range(1, LAGS + 1)]
    past += [s.u[LAGS - lag : LAGS - lag + rows] for lag in range(LAGS + 1)]
    return np.concatenate([*past, np.ones((rows, 1))], axis=1)


def _linear_model(stretches: Sequence[Stretch]) -> FloatArray | None:
    """(columns, n_y) one-step least squares over some of all flights alike; None without enough samples."""
    usable = [s for s in stretches if len(s.y) > 3 * LAGS]
    each = FIT_ROWS // max(len(usable), 1)
    gram: FloatArray | None = None
    for s in usable:
        phi = _regressors(s)[: max(each, 1)]
        both = np.concatenate([phi, s.y[LAGS : LAGS + len(phi)]], axis=1)
        product = both.T @ both
        gram = product if gram is None else gram + product
    if gram is None:
        return None
    n_y = usable[0].y.shape[1]
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(scale, scale)
    theta = np.linalg.lstsq(scaled[:-n_y, :-n_y], scaled[:-n_y, -n_y:], rcond=1e-10)[0]
    return np.asarray(theta * scale[-n_y:] / scale[:-n_y, None])


def _on_grids(stretches: Sequence[Stretch], theta: FloatArray, dt_s: float) -> dict[str, _Grid]:
    flights: dict[str, list[Stretch]] = {}
    for s in stretches:
        if len(s.y) > 3 * LAGS:
            flights.setdefault(s.flight, []).append(s)
    return {name: _on_grid(own, theta, dt_s) for name, own in flights.items()}


def _on_grid(stretches: Sequence[Stretch], theta: FloatArray, dt_s: float) -> _Grid:
    ordered = sorted(stretches, key=lambda s: s.t0_ns)
    starts, stop, end_ns = [], 0, ordered[0].t0_ns
    for s in ordered:
        pause = max(0, round((s.t0_ns - end_ns) * 1e-9 / dt_s))
        starts.append(stop + min(pause, LONGEST_PAUSE))
        stop, end_ns = starts[-1] + len(s.y), s.t0_ns + round(len(s.y) * dt_s * 1e9)
    left = [s.y[LAGS:] - _regressors(s) @ theta for s in ordered]
    white = _whitener(left)
    y, e = (np.full((stop, theta.shape[1]), np.nan) for _ in range(2))
    for start, s, rest in zip(starts, ordered, left, strict=True):
        rows = np.flatnonzero(_moving(s.y)[2 * LAGS :])  # on the ground all flights agree
        e[start + 2 * LAGS + rows] = _whitened(rest, white)[rows]
        y[start + 2 * LAGS + rows] = s.y[2 * LAGS + rows]
    known = e[np.isfinite(e[:, 0])]
    return _Grid(y, np.clip(e, *_bounds(known)) if len(known) else e)


def _moving(y: FloatArray) -> npt.NDArray[np.bool_]:
    """(N,) whether some output changed within the last samples."""
    steps = np.concatenate([[0], np.cumsum((np.diff(y, axis=0) != 0).any(axis=1))])
    before = np.concatenate([np.zeros(LAGS, dtype=steps.dtype), steps])[: len(steps)]
    return np.asarray(steps > before)


def _whitener(parts: Sequence[FloatArray]) -> FloatArray:
    """(LAGS, n_y) autoregression of each column: what is slow in a remainder is bent dynamics, not noise."""
    columns = []
    for j in range(parts[0].shape[1]):
        past = np.concatenate([_past(p[:, j]) for p in parts])
        now = np.concatenate([p[LAGS:, j] for p in parts])
        gram = past.T @ past
        ridge = (1e-6 * np.trace(gram) / LAGS + 1e-300) * np.eye(LAGS)
        columns.append(np.linalg.solve(gram + ridge, past.T @ now))
    return np.stack(columns, axis=1)


def _whitened(e: FloatArray, white: FloatArray) -> FloatArray:
    return np.stack([e[LAGS:, j] - _past(e[:, j]) @ white[:, j] for j in range(e.shape[1])], axis=1)


def _past(x: FloatArray) -> FloatArray:
    """(N - LAGS, LAGS) the samples before each."""
    return np.stack([x[LAGS - lag : len(x) - lag] for lag in range(1, LAGS + 1)], axis=1)


def _bounds(e: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Five robust standard deviations about the median: one jump must not decide a correlation."""
    middle = np.median(e, axis=0)
    reach = 5.0 * 1.4826 * np.median(np.abs(e - middle), axis=0)
    return middle - reach, middle + reach


def _best_lag(a: FloatArray, b: FloatArray) -> int:
    """The lag of b behind a at which their product is largest; NaN counts as 0."""
    size = 1 << int(np.ceil(np.log2(len(a) + len(b))))
    a, b = np.nan_to_num(a), np.nan_to_num(b)
    product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    at = int(np.argmax(product))
    return at if at < len(a) else at - size


def _overlapping(a: FloatArray, b: FloatArray, lag: int) -> tuple[FloatArray, FloatArray]:
    """The samples of a and of b moved by `lag` that both have."""
    mine, theirs = a[max(lag, 0) :], b[max(-lag, 0) :]
    common = min(len(mine), len(theirs))
    mine, theirs = mine[:common], theirs[:common]
    both = np.isfinite(mine) & np.isfinite(theirs)
    return mine[both], theirs[both]
