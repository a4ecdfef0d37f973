"""Margins of a measured loop under given gains, each with a 95 % interval, or why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.loops.between_flights import Curve, FlightScatter
from flysid.loops.controller import Controller
from flysid.loops.stick_response import ComplexArray, Loop, StickRecord, plant
from flysid.model.polynomials import DB

TRUSTED = 0.4
NEIGHBOURS = 7  # lines: one that the sticks happened to leave out ends no band
POWERS = 5  # of ln f, from 0 on: four of them bend the crossover of a plant with a lag by a standard error
FEW_POWERS = 3  # of one flight's plant beside another's: flights differ by more than those bend it
OCTAVES = (4.0, 3.0, 2.0)  # of one such curve: the fewer the less bend, and the more scatter
WINDOWS_S = (2.0, 4.0, 8.0)
LEAST_MS = 1.0
TOO_WIDE = "the measurement scatters too much; fly longer, in calmer air"
TOO_DIFFERENT = "flights differ too much; fly more of them under the same gains"
CLEAR = np.sqrt(2.0)
"""The band goes on half an octave beyond what is told of its upper part. Nearer to its end, where the sticks
fade, the plant's gain comes out too large by up to its error, and flights that reach a figure there at all
are those in which it came out low."""


@dataclass(frozen=True)
class Figure:
    """A figure and its 95 % interval; `why` it is not known where it is None.

    Where only its lower end is known, `high` is infinite and `low` is exceeded with 97.5 %.
    """

    value: float | None
    low: float = np.nan
    high: float = np.nan
    why: str = ""

    def said(self, form: str, unit: str = "") -> str:
        """For people: "12.1 Hz [11.0, 13.5]"."""
        if self.value is None:
            if np.isfinite(self.low):
                return f"at least {self.low:{form}}{unit}"
            return f"not determined: {self.why}"
        return f"{self.value:{form}}{unit} [{self.low:{form}}, {self.high:{form}}]"

    def to_dict(self) -> dict[str, float | str | None]:
        """JSON types only: an end that is open, and all of what is not known, is None."""
        value, low, high = (
            x if x is not None and np.isfinite(x) else None for x in (self.value, self.low, self.high)
        )
        return {"value": value, "low": low, "high": high, "why": self.why}


@dataclass(frozen=True)
class Margins:
    """What the present gains mean.

    `band_hz`: where the plant is known to `TRUSTED` of itself.
    `crossover_hz`, `phase_deg`, `gain_db`, `delay_ms`: where the loop's gain is one; margins there and at
        -180 deg. Where the loop reaches -180 deg above the band, the gain margin exceeds what its gain leaves
        at the band's end.
    `ms`: the largest sensitivity inside the band: how much disturbances grow at worst. Never below 1, to
        which every loop's tends where its gain fades.
    `bandwidth_hz`: where the answer to the setpoint falls to -3 dB.
    `noise`: the largest gain from measurement noise to the controller's output, inside the band.
    """

    band_hz: tuple[float, float]
    crossover_hz: Figure
    phase_deg: Figure
    gain_db: Figure
    delay_ms: Figure
    ms: Figure
    bandwidth_hz: Figure
    noise: Figure


def loop_around(records: Sequence[StickRecord], controller: Controller) -> Loop:
    """The loop in windows that show its crossover: a slow one lies below what short ones show.

    Raises DataError: the sticks show the plant in none of the windows; the reason is that of the shortest.
    """
    shortest = Loop.of(records)
    found, refused = None, None
    for window_s in WINDOWS_S:
        try:
            loop = shortest if window_s == WINDOWS_S[0] else Loop.of(records, window_s)
            low, _ = trusted_band(loop)
        except DataError as error:
            refused = refused or error
            continue
        found = loop
        at = int(np.searchsorted(loop.f, CLEAR * low))
        if np.abs(plant(loop.mean)[at] * controller.feedback(loop.f[[at]])[0]) > 1.0:
            break
    if found is None and refused is not None:
        raise refused
    return found or shortest


def trusted_band(loop: Loop, *, periods: float = 3.0) -> tuple[float, float]:
    """The widest stretch of frequencies, Hz, in which the plant is known, from some periods in a window on.

    `periods`: with fewer, the window bends the plant by more than 4 %, before that is taken off.

    Raises DataError: there is none: the sticks did not move the vehicle enough.
    """
    from scipy.ndimage import median_filter

    lowest_hz = periods * (loop.f[1] - loop.f[0])
    spread = median_filter(loop.spread(), NEIGHBOURS, mode="nearest")
    known = (spread < TRUSTED) & (loop.f >= lowest_hz)
    first = int(np.argmax(known))
    if not known[first] or loop.f[first] > 2.0 * lowest_hz:
        raise DataError(
            "the stick inputs are too small against the disturbances",
            hint="fly quick stick movements on this axis, a minute of them, in calm air",
        )
    wrong = np.flatnonzero(~known[first:])
    last = first + int(wrong[0]) - 1 if len(wrong) else len(known) - 1
    if last - first <= POWERS:  # no more lines than `smooth` has coefficients
        raise DataError(
            f"the plant is known between {loop.f[first]:.0f} and {loop.f[last]:.0f} Hz only",
            hint="fly quick stick movements on this axis, a minute of them, in calm air",
        )
    return float(loop.f[first]), float(loop.f[last])


def margins(loop: Loop, controller: Controller, between: FlightScatter | None = None) -> Margins:
    """The figures of one loop.

    `between`: scatter between flights, for intervals that hold for other flights, too. Without it they hold
        for these flights.
    Raises DataError: the plant is not known anywhere, or not where the loop's gain is one.
    """
    low, high, at = _known_band(loop)
    f = loop.f[at]
    back = controller.feedback(f)
    forward = controller.reference(f)
    centre, draws, other = _least_off(loop)
    one, more = (np.array(list_figures(f, g, back, forward)) for g in (centre, other))
    if np.isnan(one[0]):
        under = bool(np.abs(centre * back)[0] <= 1.0)
        raise DataError(
            f"the loop's gain does not pass 1 between {low:.1f} and {high:.0f} Hz, the band in which "
            f"the plant is known: it is {'below' if under else 'above'} 1 there, and crosses "
            f"{'below' if under else 'above'} the band",
            hint="fly slower stick movements: long sweeps, held attitudes, on this axis"
            if under
            else "fly quicker stick movements: steps and flicks, on this axis",
        )
    every = np.array([list_figures(f, g, back, forward) for g in draws])
    others = centre * between.moves(f, loop) if between is not None else centre[None]
    moved = np.array([list_figures(f, g, back, forward) for g in others])
    blocks = sum(len(b) for b in loop.blocks)
    lost = _reasons(f, np.vstack([centre, draws, others]), (back, forward))
    turned = np.concatenate([every[:, -1], moved[:, -1], one[-1:]])
    one = one[:-1]
    within = _reach(one, more[:-1], every[:, :-1], blocks)
    reach = within
    if between is not None:  # flights scatter by what their stretches do, too: the larger has both
        reach = np.maximum(within, between.reach(moved[:, :-1] - one))
    least = (0.0, 0.0, 0.0, 0.0, LEAST_MS, 0.0, 0.0)
    wide = [TOO_WIDE if own >= value else TOO_DIFFERENT for value, own in zip(one, within, strict=True)]
    named = [_figure(*figure) for figure in zip(one, reach, least, lost, wide, strict=True)]
    if not turned.max() < high / CLEAR:
        named[2] = _at_least(one[2] - reach[2], named[2].why or lost[2])
    return Margins((low, high), *named)


def flight_curves(loops: Sequence[Loop]) -> list[Curve]:
    """The plant of every flight of these loops, for `FlightScatter.of`; none of a flight that stands alone.

    A flight whose sticks moved too little to show its plant has none. Every flight is resampled in a loop of
    its own, which is dropped: its draws are large.
    """
    flights = [(loop.f, blocks) for loop in loops for blocks in loop.blocks]
    if len(flights) < 2:
        return []
    curves = (_curve(Loop(f, (blocks,))) for f, blocks in flights)
    return [curve for curve in curves if curve is not None]


def margins_across(
    loop: Loop, controller: Controller, curves: Sequence[Curve], own: Margins
) -> Margins | None:
    """The figures of `own` with intervals that hold the scatter between flights, too.

    None where fewer than two flights are known up to the crossover; without one, to the end of the band.
    Raises DataError: as `margins`.
    """
    scatter = FlightScatter.of(curves, own.crossover_hz.value or own.band_hz[1])
    return None if scatter is None else margins(loop, controller, scatter)


def _curve(loop: Loop) -> Curve | None:
    """None where the sticks moved too little."""
    try:
        low, high = trusted_band(loop)
    except DataError:
        return None
    at = (loop.f >= low) & (loop.f <= high)
    centre, _ = smooth(loop, at, FEW_POWERS)
    return loop.f[at], centre


def _known_band(loop: Loop) -> tuple[float, float, npt.NDArray[np.bool_]]:
    """The trusted band and its lines (F,)."""
    low, high = trusted_band(loop)
    return low, high, (loop.f >= low) & (loop.f <= high)


_kept: WeakKeyDictionary[Loop, tuple[ComplexArray, ComplexArray, ComplexArray]] = WeakKeyDictionary()


def _least_off(loop: Loop) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """As `least_off`, where the loop is known; kept for the next controller: a tuner asks what several do.

    It goes when the loop goes: a loop and what is resampled of it are large.
    """
    if loop not in _kept:
        *_, at = _known_band(loop)
        _kept[loop] = least_off(loop, at)
    return _kept[loop]


def least_off(loop: Loop, at: npt.NDArray[np.bool_]) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """The plant, its draws, and the plant with one more power, of the stretches that are off least.

    Off, on average over the lines and beside their own scatter, by the curve's scatter and by what one more
    power changes. In gusts the first counts, and stretches are long; in still air the second.
    """
    plain = plant(loop.mean)[at]
    own = np.mean(np.abs(np.log(plant(loop.draws)[:, at] / plain)) ** 2, axis=0)
    best = np.inf
    for octaves in OCTAVES:
        centre, draws = smooth(loop, at, octaves=octaves)
        other, _ = smooth(loop, at, POWERS + 1, octaves)
        off = np.mean(np.abs(np.log(draws / centre)) ** 2, axis=0) + np.abs(np.log(other / centre)) ** 2
        error = float(np.mean(off / np.maximum(own, 1e-300)))
        if error < best:
            best = error
            found = centre, draws, other
    return found


def smooth(
    loop: Loop, at: npt.NDArray[np.bool_], powers: int = POWERS, octaves: float = OCTAVES[0]
) -> tuple[ComplexArray, ComplexArray]:
    """The plant (F,) at these lines and its draws (D, F), without scatter from line to line and without bend.

    ln G is a polynomial in ln f, its phase with a delay beside, by least squares weighted with the draws'
    scatter: a largest value, as Ms is, of a ragged curve would be too large. The weight of a line is that of
    its neighbours: by its own scatter, lines would be preferred for their errors.

    A Hann window of T seconds averages spectra over frequency with the variance 1 / (3 T^2), so that the
    quotient of S_ry = G S_ru and S_ru comes out as G (1 + (G'' / G + 2 G' / G S_ru' / S_ru) / (6 T^2)). That
    is taken off; derivatives are those of the smooth curves.
    """
    from scipy.ndimage import median_filter

    f = loop.f[at]
    centre = plant(loop.mean)[at]
    away = np.log(plant(loop.draws)[:, at] / centre)
    scatter = median_filter((np.abs(away) ** 2).mean(axis=0), NEIGHBOURS, mode="nearest")
    curves = _Curves.at(f, 1.0 / np.sqrt(np.maximum(scatter, 1e-8)), powers, octaves)
    sent = loop.mean[0, 1][at]
    sent_away = np.log(loop.draws[:, 0, 1][:, at] / sent)
    window_s = 1.0 / (loop.f[1] - loop.f[0])
    own = curves.of(centre)
    others = own[:, None] + curves.through(away)
    driven = curves.of(sent)
    return _unbent(own, driven, window_s), _unbent(
        others, driven[:, None] + curves.through(sent_away), window_s
    )


def _unbent(ln_plant: ComplexArray, ln_sent: ComplexArray, window_s: float) -> ComplexArray:
    """(..., F) a plant without what the window does to it; of (3, ..., F) logarithms and two derivatives."""
    level, slope, second = ln_plant
    bend = (second + slope**2 + 2.0 * slope * ln_sent[1]) / (6.0 * window_s**2)
    return np.asarray(np.exp(level) / (1.0 + bend))


@dataclass(frozen=True, eq=False)
class _Curves:
    """Fits of ln G by powers of ln f, and of its phase by those and f, over stretches of a few octaves.

    A band that reaches far, as in still air, holds bends that one curve would spread over all of it. Lines
    between the middles of two stretches have what both say, by their distance from either.

    `size`, `turn`: (3, F, F) from ln |G| and from the phase of the lines to those of the curves, and to their
        first and second derivatives by f.
    """

    size: FloatArray
    turn: FloatArray

    @classmethod
    def at(cls, f: FloatArray, weight: FloatArray, powers: int, octaves: float) -> _Curves:
        x = np.log2(f / f[0])
        beyond = max(0.0, x[-1] - octaves)
        starts = np.linspace(0.0, beyond, 1 + int(np.ceil(2.0 * beyond / octaves)))
        middles = starts + 0.5 * octaves
        shares = np.array([np.interp(x, middles, row) for row in np.eye(len(starts))])
        maps = np.zeros((2, 3, len(f), len(f)))
        for start, share in zip(starts, shares, strict=True):
            inside = (x >= start - 1e-9) & (x <= start + octaves + 1e-9)
            own = _stretch(f[inside], weight[inside], powers)
            maps[:, :, np.flatnonzero(inside)[:, None], np.flatnonzero(inside)] += (
                share[inside][:, None] * own
            )
        return cls(*maps)

    def of(self, values: ComplexArray) -> ComplexArray:
        """(3, F) the fit of ln values and its first and second derivatives."""
        return np.asarray(self.size @ np.log(np.abs(values)) + 1j * (self.turn @ np.unwrap(np.angle(values))))

    def through(self, away: ComplexArray) -> ComplexArray:
        """(3, D, F) the fits of logarithms and their derivatives."""
        turned = away.imag @ self.turn.transpose(0, 2, 1)
        return np.asarray(away.real @ self.size.transpose(0, 2, 1) + 1j * turned)


def _stretch(f: FloatArray, weight: FloatArray, powers: int) -> FloatArray:
    """(2, 3, F, F) of one stretch, as `_Curves` has them of all: of the size, of the phase."""
    x = np.log(f / np.sqrt(f[0] * f[-1]))[:, None]
    n = np.arange(powers)
    by_x = n * x ** np.maximum(n - 1, 0)
    twice = n * (n - 1) * x ** np.maximum(n - 2, 0)
    g = f[:, None]
    rows = [
        np.column_stack(pair)
        for pair in ((x**n, f), (by_x / g, np.ones_like(f)), ((twice - by_x) / g**2, np.zeros_like(f)))
    ]
    basis = np.array(rows)
    weighted = basis[0] * weight[:, None]
    parts = (basis[:, :, :powers], weighted[:, :powers]), (basis, weighted)
    return np.array([shapes @ (np.linalg.pinv(heavy) * weight) for shapes, heavy in parts])


def list_figures(f: FloatArray, g: ComplexArray, back: ComplexArray, forward: ComplexArray) -> list[float]:
    """In the order of `Margins`, and where the loop is at -180 deg; NaN for what is not reached.

    The gain margin of a loop that turns above f, where it has fallen further, is that of the end of f; it is
    turned at infinity then.
    """
    loop = g * back
    size = np.log(np.abs(loop))
    turn = np.unwrap(np.angle(loop))
    turn -= (
        2.0 * np.pi * np.round((turn[0] + 0.5 * np.pi) / (2.0 * np.pi))
    )  # an integrator's -90 deg at first
    crossover = _falls(f, size)
    phase = 180.0 + np.degrees(np.interp(crossover, f, turn)) if np.isfinite(crossover) else np.nan
    turned = _falls(f, turn + np.pi)
    if np.isnan(turned) and turn[-1] > -np.pi:
        turned = np.inf
    gain = -DB * np.interp(turned, f, size) if not np.isnan(turned) else np.nan
    sensitivity = np.abs(1.0 / (1.0 + loop))
    answer = np.log(np.abs(g * forward / (1.0 + loop)) * np.sqrt(2.0))
    delay = 1000.0 * phase / (360.0 * crossover)
    return [
        crossover,
        float(phase),
        float(gain),
        float(delay),
        float(sensitivity.max()),
        _falls(f, answer),
        float((np.abs(back) * sensitivity).max()),
        turned,
    ]


def _reasons(
    f: FloatArray, plants: ComplexArray, controller: tuple[ComplexArray, ComplexArray]
) -> tuple[str, ...]:
    """Why a figure is not reached, in the order of `Margins`: it lies above the band, or below.

    Below lies what some draw of the plant (D, F) has passed before the band begins.
    """
    back, forward = controller
    loop = plants * back
    above = f"above {f[-1]:.0f} Hz, which the sticks do not excite"
    below = f"below {f[0]:.1f} Hz, slower than such a record tells; an outer loop's logs or a sweep would"
    crossing = below if (np.abs(loop[:, 0]) <= 1.0).any() else above
    answer = np.abs(plants * forward / (1.0 + loop))[:, 0] * np.sqrt(2.0)
    bandwidth = below if (answer <= 1.0).any() else above
    return (crossing, crossing, above, crossing, above, bandwidth, above)


def _falls(f: FloatArray, values: FloatArray) -> float:
    """The last frequency at which values fall through zero; NaN where they do not."""
    down = np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))
    if not len(down):
        return np.nan
    k = int(down[-1])
    share = values[k] / (values[k] - values[k + 1])
    return float(np.exp((1.0 - share) * np.log(f[k]) + share * np.log(f[k + 1])))


def _reach(one: FloatArray, more: FloatArray, every: FloatArray, blocks: int) -> FloatArray:
    """(M,) half the widths of the intervals; NaN where a draw does not reach a figure: they would be cut off.

    Student's t times the draws' standard deviation, as a resample of B blocks scatters less than the blocks
    do, and beside it what one more power of ln f changes: how curves bend is not known either.
    """
    scatter = every.std(axis=0) * np.sqrt(blocks / (blocks - 1))
    return np.asarray(stdtrit(blocks - 1, 0.975) * np.hypot(scatter, np.nan_to_num(more - one)))


def _figure(value: float, reach: float, least: float, beyond: str, wide: str = TOO_WIDE) -> Figure:
    """With its interval, nothing of it below the least that the figure can be; or why there is none.

    `beyond`: where it lies where it is not reached; see `_reasons`. `wide`: why its interval is too wide.
    """
    if np.isnan(value) or np.isnan(reach):
        return Figure(None, why=beyond)
    if value <= reach:
        return Figure(None, why=wide)
    told, low, high = (max(float(v), least) for v in (value, value - reach, value + reach))
    return Figure(told, low, high)


def _at_least(low: float, why: str) -> Figure:
    """What a figure exceeds, where its upper end is beyond the band; nothing where that is not positive."""
    return Figure(None, float(low), np.inf, why) if low > 0.0 else Figure(None, why=why)
