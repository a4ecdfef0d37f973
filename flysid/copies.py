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
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from flysid.stretch import FloatArray, Stretch

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
LEAST_NOISE = 40  # samples whose noise is compared
LEAST_OVERLAP = 15  # samples whose outputs are compared
LEAST_CORRELATION = (
    0.3  # of the remainders of two recordings of one flight, at rates that differ by up to ten
)
SAME_OUTPUT = 0.02  # of its spread
SAME_GAIN = 0.1  # of an output: by how much the factors of two recorders may differ
NEIGHBOURS = 2  # samples on either side of one that another recorder may have mixed into it
SAME_SHARE = 0.5  # of a flight whose outputs agree so well
SAME_INPUT = 0.5  # of its spread: steps fall between the samples of the other recorder
SIGMAS = 3.5  # of a correlation beyond the largest that chance makes over all lags
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


@dataclass(frozen=True, eq=False)
class _Windows:
    """Every COPY_ROWS rows of some flights that are not all alike, in the order of their hashes.

    Attributes
    ----------
    hashes, flight, row : (n,) of every window: hash, number of its flight, its first row in that flight.
    counts : (flights,) how many windows each flight has.
    steps : per flight the rows, rising, at which an output changes.
    """

    hashes: Hashes
    flight: Indices
    row: Indices
    counts: Indices
    steps: Mapping[int, Indices]


def _same_samples(train: Sequence[Stretch], test: Sequence[Stretch]) -> Copy | None:
    """Windows of a held-out flight that stand in one training flight, all moved by the same number of rows.

    A window may be alike by chance, where signals are coarse or the vehicle stands; many at one lag are
    not. What stands still in both says nothing: some outputs must change, or all of the flight must agree.
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
    """Tests 2 and 3, flight by flight."""
    theta = _linear_model([*train, *test])
    known, held = (_on_grids(part, theta, dt_s) for part in (train, test))
    for name, mine in held.items():
        for other, theirs in known.items():
            how = "" if other == name else _same_noise(theirs, mine) or _same_output(theirs, mine)
            if how:
                return Copy(name, other, how)
    return None


@dataclass(frozen=True, eq=False)
class _Signal:
    """(N,) one signal of a flight; NaN in gaps, which count as 0 in its spectrum."""

    x: FloatArray
    spectra: dict[int, npt.NDArray[np.complex128]] = field(default_factory=dict)
    known_powers: dict[int, npt.NDArray[np.complex128]] = field(default_factory=dict)

    @cached_property
    def size(self) -> float:
        """The largest magnitude: squares of huge units would overflow."""
        return float(np.nanmax(np.abs(self.x))) or 1.0

    @cached_property
    def spread(self) -> float:
        """The standard deviation, in units of `size`."""
        return float(np.nanstd(self.x / self.size))

    def spectrum(self, size: int) -> npt.NDArray[np.complex128]:
        """Of the signal without its mean, filled up to `size`; kept, as every flight meets many others."""
        if size not in self.spectra:
            known = np.isfinite(self.x)
            mean = self.x[known].mean() if known.any() else 0.0
            self.spectra[size] = np.fft.rfft(np.where(known, self.x - mean, 0.0), size)
        return self.spectra[size]

    def powers(self, size: int) -> npt.NDArray[np.complex128]:
        """(3, size / 2 + 1) spectra of where it is known, of itself, of its square; in units of its size."""
        if size not in self.known_powers:
            known = np.isfinite(self.x)
            x = np.where(known, self.x / self.size, 0.0)
            self.known_powers[size] = np.fft.rfft([known, x, x**2], size)
        return self.known_powers[size]


@dataclass(frozen=True, eq=False)
class _Grid:
    """One flight on a grid of time: (N, n_u) inputs, (N, n_y) outputs and what the model leaves of them, NaN
    in gaps."""

    u: FloatArray
    y: FloatArray
    e: FloatArray

    @cached_property
    def samples(self) -> int:
        return int(np.isfinite(self.e[:, 0]).sum())

    @cached_property
    def outputs(self) -> tuple[_Signal, ...]:
        return tuple(_Signal(column) for column in self.y.T)

    @cached_property
    def moves(self) -> tuple[_Signal, ...]:
        """How the outputs change from sample to sample."""
        return tuple(_Signal(column) for column in np.diff(self.y, axis=0).T)

    @cached_property
    def remainders(self) -> tuple[_Signal, ...]:
        return tuple(_Signal(column) for column in self.e.T)

    @cached_property
    def flown(self) -> int:
        """Samples in which the outputs move."""
        return int(np.isfinite(self.y[:, 0]).sum())


def _same_noise(theirs: _Grid, mine: _Grid) -> str:
    """How two flights share their noise, or ''."""
    if min(theirs.samples, mine.samples) < LEAST_NOISE:
        return ""
    for a, b in zip(theirs.remainders, mine.remainders, strict=True):
        x, z = _overlapping(a.x, b.x, _best_lag(a, b))
        if len(x) < max(LEAST_NOISE, COPY_SHARE * mine.samples):
            continue
        x = x - x.mean()
        z = z - z.mean()
        if not (x.any() and z.any()):
            continue
        # squares of tiny units would vanish
        x = x / np.abs(x).max()
        z = z / np.abs(z).max()
        rho = float(x @ z / np.sqrt((x @ x) * (z @ z)))
        chance = np.sqrt(
            2.0 * np.log(len(a.x) + len(b.x))
        )  # the largest of so many lags, in standard deviations
        if rho > LEAST_CORRELATION and rho * np.sqrt(len(x)) > chance + SIGMAS:
            share = 100.0 * len(x) / mine.samples
            return f"its noise is the same over {share:.0f} % of it (correlation {rho:.2f})"
    return ""


def _same_output(theirs: _Grid, mine: _Grid) -> str:
    """How the outputs of two flights agree, or ''; their inputs must agree roughly."""
    if min(theirs.flown, mine.flown) < LEAST_OVERLAP:
        return ""
    pairs = [*zip(theirs.outputs, mine.outputs, strict=True), *zip(theirs.moves, mine.moves, strict=True)]
    lags = dict.fromkeys(_best_lag(a, b) for a, b in pairs)  # a part of a flight shows by its moves
    least = max(LEAST_OVERLAP, SAME_SHARE * mine.flown) - 1  # of samples, so of moves
    lags.update(
        dict.fromkeys(_closest_lag(a, b, least) for a, b in zip(theirs.moves, mine.moves, strict=True))
    )
    share = max((_share_of_same(theirs, mine, lag) for lag in lags), default=0.0)
    return (
        f"its outputs are the same to within {100.0 * SAME_OUTPUT:.0f} % over {100.0 * share:.0f} % of it"
        if share
        else ""
    )


def _share_of_same(theirs: _Grid, mine: _Grid, lag: int) -> float:
    """The share of a flight whose outputs agree with another's at some lag; 0 where one of them does not."""
    shares = list[float]()
    for a, b in zip(theirs.outputs, mine.outputs, strict=True):
        if b.spread == 0.0:
            continue
        x, z = _overlapping(a.x, b.x, lag)
        if len(x) < max(LEAST_OVERLAP, SAME_SHARE * mine.flown):
            return 0.0
        if _apart(x / b.size, z / b.size, SAME_OUTPUT * b.spread):
            return 0.0
        shares.append(len(x) / mine.flown)
    alike = all(_alike(*_overlapping(a, b, lag)) for a, b in zip(theirs.u.T, mine.u.T, strict=True))
    return min(1.0, *shares) if shares and alike else 0.0


def _apart(x: FloatArray, z: FloatArray, limit: float) -> bool:
    """Whether two records differ by more than `limit` (RMS), one of them filtered as suits them best.

    Another recorder has its own zero and rounds its factors, samples at other times, and smooths: a constant
    and five neighbours of each sample take all that out. Which of them it did that to is not known.
    """
    return _filtered_apart(x, z, limit) and _filtered_apart(z, x, limit)


def _filtered_apart(x: FloatArray, z: FloatArray, limit: float) -> bool:
    """Whether samples of z around each one of x leave more than `limit` of it, or are larger or smaller."""
    rows = len(x) - 2 * NEIGHBOURS
    near = [z[k : k + rows] for k in range(2 * NEIGHBOURS + 1)]
    columns = np.stack([np.ones(rows), *near, x[NEIGHBOURS : NEIGHBOURS + rows]], axis=1)
    (triangle, _) = np.linalg.qr(columns, "raw")  # transposed
    rest = abs(triangle[-1, columns.shape[1] - 1])
    if rest > limit * np.sqrt(max(rows - columns.shape[1] + 1, 1)):
        return True
    weights = np.linalg.lstsq(columns[:, :-1], columns[:, -1], rcond=None)[0]
    return bool(abs(weights[1:].sum() - 1.0) > SAME_GAIN)  # larger or smaller flights, not another's factor


def _alike(x: FloatArray, z: FloatArray) -> bool:
    """Whether two records of an input are: a step may be a sample late, where values are held."""
    return not _apart(x, z, SAME_INPUT * float(np.std(z))) or not np.any(x != z)


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


def _on_grids(stretches: Sequence[Stretch], theta: FloatArray | None, dt_s: float) -> dict[str, _Grid]:
    flights: dict[str, list[Stretch]] = {}
    for s in stretches:
        flights.setdefault(s.flight, []).append(s)
    return {name: _on_grid(own, theta, dt_s) for name, own in flights.items()}


def _on_grid(stretches: Sequence[Stretch], theta: FloatArray | None, dt_s: float) -> _Grid:
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
        return _Grid(u, y, e)
    left = [ordered[k].y[LAGS:] - _regressors(ordered[k]) @ theta for k in long]
    white = _whitener(left)
    for k, rest in zip(long, left, strict=True):
        rows = moving[k][moving[k] >= 2 * LAGS]
        e[starts[k] + rows] = _whitened(rest, white)[rows - 2 * LAGS]
    known = e[np.isfinite(e[:, 0])]
    return _Grid(u, y, np.clip(e, *_bounds(known)) if len(known) else e)


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


def _best_lag(theirs: _Signal, mine: _Signal) -> int:
    """The lag of mine behind theirs at which their product is largest; NaN counts as 0."""
    size = 1 << int(np.ceil(np.log2(len(theirs.x) + len(mine.x))))
    at = int(np.argmax(np.fft.irfft(theirs.spectrum(size) * np.conj(mine.spectrum(size)), size)))
    return at if at < len(theirs.x) else at - size


def _closest_lag(theirs: _Signal, mine: _Signal, least: float) -> int:
    """The lag of mine behind theirs at which they differ least, where at least so many samples overlap."""
    size = 1 << int(np.ceil(np.log2(len(theirs.x) + len(mine.x))))
    a = theirs.powers(size)
    b = np.conj(mine.powers(size))
    scale = theirs.size / mine.size
    apart = scale**2 * a[2] * b[0] + a[0] * b[2] - 2.0 * scale * a[1] * b[1]
    count, gap = np.fft.irfft([a[0] * b[0], apart], size)
    mean = np.where(count > least - 0.5, gap / np.maximum(count, 1.0), np.inf)
    at = int(np.argmin(mean))
    return at if at < len(theirs.x) else at - size


def _overlapping(a: FloatArray, b: FloatArray, lag: int) -> tuple[FloatArray, FloatArray]:
    """The samples of a and of b moved by `lag` that both have."""
    mine = a[max(lag, 0) :]
    theirs = b[max(-lag, 0) :]
    common = min(len(mine), len(theirs))
    mine = mine[:common]
    theirs = theirs[:common]
    both = np.isfinite(mine) & np.isfinite(theirs)
    return mine[both], theirs[both]
