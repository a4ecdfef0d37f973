"""The frequency response by local polynomials (Pintelon & Schoukens, 2012, System Identification, ch. 7).

The discrete Fourier transform of a segment obeys, without any window,

    Y(w_k) = G(w_k) U(w_k) + T(w_k) + V(w_k),

T the smooth transient of the segment's edges (what leakage is), V noise that is independent from line to
line. Around every frequency w, G and each segment's T are polynomials in w_k - w, fitted by least squares to
the lines of all segments within a band: G is common, T is each segment's own. Leakage is thus fitted instead
of tapered away, one record is enough, and the residual gives the noise, hence intervals.

Which band and which degree of T: of three widths and two degrees the pair with the smallest random error; too
wide a band or too stiff a transient shows in the residual. (Degree 2 takes what a chirp does in its first
seconds for a transient; degree 0 leaves it to the input.) Where the input has only a few lines (a sparse
multisine), G is a line or a constant, and a constant belongs where the power of its lines lies.

What G and T bend within a band is an error that all points nearby share, and that a residual hides under its
noise. So every point is fitted once more with two degrees more of both: what the two part by, beyond chance,
over the points that share its lines, counts as noise. Beyond the last line of an input, where all it holds is
leakage that looks like a transient, nothing is left to trust.

In a loop the input answers the noise, and that G is no plant. With references R that drive the loop from
outside, inputs and output are both fitted to them, and the quotient is the plant's (joint input-output:
Pintelon & Schoukens, 2012, 2.6.4, 7.2.7; of several references the one of least variance):

    U = G_ru R + ..., Y = G_ry R + ...,   G = G_ry / G_ru;

its error is what Y - G U leaves over, in which the noise that the loop brought back cancels to first order.

Cost: one transform per segment and seven small least-squares problems per frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.model.frequency.spectral import Spectral, grid, highest_frequency
from flysid.model.polynomials import ComplexArray

IntArray = npt.NDArray[np.int64]

DEGREE = 2
TRANSIENT_DEGREES = (0, 2)
WIDTHS = (0.06, 0.12, 0.24)
"""Half widths of a band as shares of its frequency."""
WIDEST = 1.0
FREEDOM = 6
"""Lines beyond the unknowns that a point needs."""


@dataclass(frozen=True, eq=False)
class _Lines:
    """One segment's transform without frequency 0: omega (K,), what drives (K, n), what is driven (K, m);
    index of its first line among all segments' lines."""

    omega: FloatArray
    drives: ComplexArray
    driven: ComplexArray
    first: int


@dataclass(frozen=True)
class _Place:
    """A band: its middle (rad/s), its half width as a share of that, degree of the transients, and of G."""

    omega: float
    width: float
    transient: int
    degree: int | None = None
    """None: as high as the lines carry, at most DEGREE."""


@dataclass(frozen=True, eq=False)
class _LocalPoint:
    """One frequency: where (rad/s), gains, their variances at a noise of 1 (complex), noise power, degrees of
    freedom, averages, how every line enters the gains (weights (n_u, M) on lines `where`), the least
    coherence of the references with an input or the output (1 without references), how it was fitted, and
    what share of the drives' power is no transient."""

    omega: float
    gain: ComplexArray
    unit: FloatArray
    noise: float
    freedom: int
    averages: float
    weights: ComplexArray
    where: IntArray
    place: _Place
    driven: float = 1.0
    heard: float = 1.0

    @property
    def error(self) -> float:
        """Largest relative variance over the inputs."""
        return self.error_with(0.0)

    def error_with(self, left: float | FloatArray) -> float:
        """The same with more variance of the gains."""
        return float(np.max((self.noise * self.unit + left) / np.maximum(np.abs(self.gain) ** 2, 1e-300)))


def local_response(
    records: Sequence[FloatArray],
    dt_s: float,
    points: int,
    band: tuple[float, float] | None,
    references: int = 0,
) -> Spectral:
    """Measure; records are (N, references + n_u + 1): references, inputs, the output, in units of their
    standard deviations.

    Raises DataError: no frequency has lines enough. Raises UsageError: the band holds none of the
    frequencies.
    """
    n_u = references or records[0].shape[1] - 1
    lines = _transform(records, dt_s, n_u)
    lowest = _lowest(lines, n_u)
    if not lowest < highest_frequency(dt_s):
        longest = max(map(len, records))
        raise DataError(
            f"segments of at most {longest} samples are too short for a frequency response",
            hint=f"bring a segment of at least {8 * (_unknowns(n_u) + FREEDOM)} samples",
        )
    omega = grid(lowest, dt_s, points, band)
    found = [_best_point(lines, float(w), n_u) for w in omega]
    picked = _in_order([p for p in found if p is not None], 0.5 * float(np.log(omega[1] / omega[0])))
    if len(picked) < 2:
        raise DataError(
            "hardly any frequency is excited: no response can be measured",
            hint="fly a sweep, steps or doublets, or fit a model of few parameters (OE, ARX)",
        )
    return _join(*_refine(lines, picked, n_u))


def _refine(
    lines: Sequence[_Lines], points: list[_LocalPoint], n_u: int, *, heard: float = 0.5
) -> tuple[list[_LocalPoint], FloatArray]:
    """Points, each replaced by its check where that errs less, and the variance by what they leave out.

    A check that takes more of an input for a transient than it leaves (`heard`, a share of the power)
    replaces nothing: it lives on how the input differs from a transient of that degree.
    """
    checks = [_check(lines, p, n_u) for p in points]
    left = _left_out(points, checks)
    better = {
        k: check
        for k, (point, check) in enumerate(zip(points, checks, strict=True))
        if check is not None
        and check.freedom >= FREEDOM
        and check.heard > heard
        and check.error < point.error_with(left[k])
    }
    if not better:
        return points, left
    points = [better.get(k, p) for k, p in enumerate(points)]
    checks = [_check(lines, p, n_u) if k in better else checks[k] for k, p in enumerate(points)]
    return points, _left_out(points, checks)


def _in_order(points: Sequence[_LocalPoint], least: float) -> list[_LocalPoint]:
    """By frequency; of points that moved onto the same line, nearer than `least` in ln omega, the best."""
    kept: list[_LocalPoint] = []
    for point in sorted(points, key=lambda p: p.omega):
        if not kept or np.log(point.omega / kept[-1].omega) > least:
            kept.append(point)
        elif point.error < kept[-1].error:
            kept[-1] = point
    return kept


def _check(lines: Sequence[_Lines], point: _LocalPoint, n_u: int, *, more: int = 2) -> _LocalPoint | None:
    """The same point, degrees of G and T higher by `more`; None where the lines do not carry them."""
    at = point.place
    return _fit(lines, replace(at, transient=at.transient + more, degree=(at.degree or 0) + more), n_u)


def _transform(records: Sequence[FloatArray], dt_s: float, drives: int) -> list[_Lines]:
    found = []
    first = 0
    for record in records:
        spectrum = np.fft.rfft(record, axis=0)[1:] / np.sqrt(len(record))
        if len(record) % 2 == 0:
            spectrum = spectrum[:-1]  # the Nyquist line is real
        lines = np.arange(1, len(spectrum) + 1, dtype=np.float64)
        omega = np.asarray(lines * (2.0 * np.pi / (len(record) * dt_s)))
        found.append(_Lines(omega, spectrum[:, :drives], spectrum[:, drives:], first))
        first += len(spectrum)
    return found


def _unknowns(n_u: int) -> int:
    return n_u * (DEGREE + 1) + max(TRANSIENT_DEGREES) + 1


def _free_lines(lines: Sequence[_Lines], low: float, high: float, n_u: int) -> int:
    """Lines in a band beyond the unknowns; a segment with no more lines than its transient says nothing."""
    total = 0
    for segment in lines:
        inside = np.searchsorted(segment.omega, high, "right") - np.searchsorted(segment.omega, low)
        total += max(int(inside) - max(TRANSIENT_DEGREES) - 1, 0)
    return total - n_u * (DEGREE + 1)


def _lowest(lines: Sequence[_Lines], n_u: int) -> float:
    """The lowest frequency whose widest band has lines enough."""
    steps = max((s.omega for s in lines if len(s.omega)), key=len, default=np.zeros(0))
    for omega in steps:
        if _free_lines(lines, 0.0, (1.0 + WIDEST) * float(omega), n_u) >= FREEDOM:
            return float(omega)
    return np.inf


def _best_point(lines: Sequence[_Lines], omega: float, n_u: int) -> _LocalPoint | None:
    """The point of smallest random error among the band widths with lines enough."""
    widths = [w for w in WIDTHS if _free_lines(lines, omega * (1 - w), omega * (1 + w), n_u) >= FREEDOM]
    if not widths:
        wide = WIDTHS[-1]
        while wide < WIDEST and _free_lines(lines, omega * (1 - wide), omega * (1 + wide), n_u) < FREEDOM:
            wide = min(1.15 * wide, WIDEST)
        widths = [wide]
    found = [_fit(lines, _Place(omega, w, t), n_u) for w in widths for t in TRANSIENT_DEGREES]
    best = [p for p in found if p is not None]
    few = [p.place for p in best if p.place.degree != DEGREE]
    full = [_fit(lines, replace(place, degree=DEGREE), n_u) for place in few]
    best += [p for p in full if p is not None]
    return min(best, key=lambda p: p.error) if best else None


def _fit(lines: Sequence[_Lines], place: _Place, n_u: int) -> _LocalPoint | None:
    """Local least squares; None where the inputs have no power there."""
    omega, width = place.omega, place.width
    powers = (DEGREE if place.degree is None else place.degree) + 1
    blocks = []
    power = np.zeros(n_u)
    rows = []
    where = []
    for segment in lines:
        at = slice(*np.searchsorted(segment.omega, [omega * (1 - width), omega * (1 + width)]))
        d = (segment.omega[at] - omega) / (omega * width)
        if len(d) <= place.transient + 1:
            continue
        basis, _ = np.linalg.qr(np.vander(d, place.transient + 1, increasing=True))
        columns = (
            segment.drives[at][:, None, :] * np.vander(d, powers, increasing=True)[:, :, None]
        ).reshape(len(d), -1)
        both = np.column_stack([columns, segment.driven[at]])
        blocks.append(both - basis @ (basis.T @ both))
        power += np.sum(np.abs(segment.drives[at]) ** 2, axis=0)
        rows.append(len(d) - place.transient - 1)
        where.append(np.arange(segment.first + at.start, segment.first + at.stop))
    if not blocks:
        return None
    phi, driven = np.split(np.concatenate(blocks), [n_u * powers], axis=1)
    point = _solve(phi, driven, sum(rows), n_u, np.concatenate(where), place)
    heard = np.sum(np.abs(phi[:, :n_u]) ** 2, axis=0) / np.maximum(power, 1e-300)
    return None if point is None else replace(point, heard=float(heard.min()))


def _solve(
    phi: ComplexArray,
    driven: ComplexArray,
    rows: int,
    n_u: int,
    where: IntArray,
    place: _Place,
    *,
    leverage: float = 2.25,
    lines_per_power: float = 2.0,
) -> _LocalPoint | None:
    """Gains at the band's middle: the first n_u unknowns, of every driven signal.

    Parameters
    ----------
    leverage : a local parabola's variance in its middle, in units of that of a mean.
    lines_per_power : lines with power that every power of G needs.
    """
    size = np.abs(phi[:, :n_u]) ** 2
    total = size.sum(axis=0)
    if not (total > 1e-20 * max(float(np.sum(np.abs(driven) ** 2)), 1e-300)).all():
        return None
    omega, degree = place.omega, place.degree
    if degree is None:
        spread = total**2 / np.maximum((size**2).sum(axis=0), 1e-300)
        degree = int(np.clip(spread.min() / lines_per_power - 1.0, 0, DEGREE))
        place = replace(place, degree=degree)
        if not degree:
            off = np.sum(np.conj(phi[:, :n_u]) * phi[:, n_u : 2 * n_u], axis=0).real / total
            omega *= 1.0 + place.width * float(off.mean())
        phi = phi[:, : n_u * (degree + 1)]
    averages = float(rows) if degree < 2 else rows / leverage
    lengths = np.sqrt(np.maximum((np.abs(phi) ** 2).sum(axis=0), 1e-300))
    left, sigma, right = np.linalg.svd(phi / lengths, full_matrices=False)
    kept = sigma > 1e-7 * sigma[0]
    freedom = rows - int(kept.sum())
    if freedom < 2 or not kept.all():
        return None
    pseudo = (np.conj(right.T) / sigma) @ np.conj(left.T) / lengths[:, None]
    theta = pseudo @ driven
    residual = driven - phi @ theta
    averages = max(averages - n_u + 1, 1.0)
    if driven.shape[1] > 1:
        return _quotient(theta[:n_u], residual, pseudo[:n_u], (freedom, averages), where, (omega, place))
    noise = float(np.sum(np.abs(residual) ** 2)) / freedom
    weights = pseudo[:n_u]
    unit = np.asarray((np.abs(weights) ** 2).sum(axis=1), dtype=np.float64)
    return _LocalPoint(omega, theta[:n_u, 0], unit, noise, freedom, averages, weights, where, place)


def _quotient(
    through: ComplexArray,
    residual: ComplexArray,
    weights: ComplexArray,
    counts: tuple[int, float],
    where: IntArray,
    at: tuple[float, _Place],
) -> _LocalPoint | None:
    """The plant behind what references (rows of `through`) do to its inputs and, last, to its output."""
    from scipy.special import fdtri

    freedom, averages = counts
    n_u = through.shape[1] - 1
    spread = weights @ np.conj(weights.T)
    try:
        power = np.linalg.inv(spread)
        # least squares over the references, each by how well it is told
        information = np.conj(through[:, :n_u].T) @ power @ through[:, :n_u]
        solve = np.linalg.solve(information, np.conj(through[:, :n_u].T) @ power)
        unit = np.linalg.inv(information)
    except np.linalg.LinAlgError:
        return None
    gain = solve @ through[:, n_u]
    left = residual[:, n_u] - residual[:, :n_u] @ gain
    brought = np.einsum("rt,rs,st->t", np.conj(through), power, through).real / averages
    noise = (np.abs(residual) ** 2).sum(axis=0) / freedom
    told = brought / np.maximum(brought + noise, 1e-300)
    # Fieller (1954, J. Roy. Stat. Soc. B 16): a quotient's interval is the wider the less is known of its
    # denominator, and has no end where that may be 0
    chance = noise[:n_u] * float(fdtri(2, 2 * freedom, 0.95)) / np.maximum(averages * brought[:n_u], 1e-300)
    if not chance.max() < 1.0:
        return None
    return _LocalPoint(
        omega=at[0],
        gain=gain,
        unit=np.asarray(np.diag(unit).real) / (1.0 - chance.max()),
        noise=float(np.sum(np.abs(left) ** 2)) / freedom,
        freedom=freedom,
        averages=averages,
        weights=solve @ weights,
        where=where,
        place=at[1],
        driven=float(told.min()),
    )


def _join(points: Sequence[_LocalPoint], left: FloatArray) -> Spectral:
    gain = np.stack([p.gain for p in points])
    unit = np.stack([p.unit for p in points])
    averages = np.array([p.averages for p in points])[:, None]
    # the input's power is the one that explains the variance that least squares gives with so many averages:
    # an input that looks like a transient has none, whatever its lines are
    explained = np.abs(gain) ** 2 / np.maximum(averages * unit, 1e-300)
    noise = np.array([p.noise for p in points])[:, None] + left / unit
    noise = np.maximum(noise, 1e-15 * explained)
    coherence = explained / np.maximum(explained + noise, 1e-300)
    with np.errstate(divide="ignore", over="ignore"):
        error = np.sqrt(noise / (2.0 * averages * explained))
    return Spectral(
        omega=np.array([p.omega for p in points]),
        response=gain,
        coherence=np.minimum(coherence, np.array([p.driven for p in points])[:, None]),
        error=error,
        averages=np.repeat(averages, gain.shape[1], axis=1),
        freedom=np.array([2.0 * p.freedom for p in points]),
        correlation=_correlations(points),
    )


def _left_out(points: Sequence[_LocalPoint], checks: Sequence[_LocalPoint | None]) -> FloatArray:
    """(F, n_u) variance of the gains by what the degrees of their points leave out.

    How much more a point and its check part than chance lets them, in units of that chance, is averaged over
    the points with the squares of their correlations: as far as they share lines.
    """
    chance = np.array([p.noise * p.unit for p in points])
    parted = np.zeros_like(chance)
    known = np.zeros(len(points))
    for k, (point, check) in enumerate(zip(points, checks, strict=True)):
        if check is not None and check.freedom > 2:
            known[k] = 1.0
            fair = check.freedom / (check.freedom - 1.0)  # mean of F with 2 and 2 x freedom
            chance[k] = check.noise * np.maximum(check.unit - point.unit, 0.0)
            parted[k] = np.abs(check.gain - point.gain) ** 2 / np.maximum(fair * chance[k], 1e-300)
    weight = _correlations(points) ** 2 * known
    with np.errstate(invalid="ignore"):
        ratio = np.einsum("jkl,lj->kj", weight, parted) / weight.sum(axis=2).T
    return np.asarray(chance * np.maximum(np.nan_to_num(ratio, nan=1.0) - 1.0, 0.0))


def _correlations(points: Sequence[_LocalPoint]) -> FloatArray:
    """(n_u, F, F) of the relative errors."""
    return np.stack([_correlation(points, j) for j in range(len(points[0].gain))])


def _correlation(points: Sequence[_LocalPoint], source: int) -> FloatArray:
    """(F, F) of the relative errors: common lines, with the phases of the gains taken out."""
    from scipy.sparse import csr_array

    rows = [p.weights[source] / p.gain[source] for p in points]
    indptr = np.cumsum([0, *(len(r) for r in rows)])
    width = 1 + max(int(p.where.max()) for p in points)
    matrix = csr_array(
        (np.concatenate(rows), np.concatenate([p.where for p in points]), indptr), (len(rows), width)
    )
    gram = np.asarray((matrix @ matrix.conj().T).toarray()).real
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    return np.asarray(np.clip(gram / np.outer(size, size), -1.0, 1.0))
