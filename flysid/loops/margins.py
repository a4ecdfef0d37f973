"""Margins of a measured loop under given gains, each with a 95 % interval, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter
from scipy.special import stdtrit

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.loops.controller import Controller
from flysid.loops.stick_response import ComplexArray, Loop, plant
from flysid.model.polynomials import DB

TRUSTED = 0.4
NEIGHBOURS = 7  # lines: one that the sticks happened to leave out ends no band
POWERS = 5  # of ln f, from 0 on: four of them bend the crossover of a plant with a lag by a standard error


@dataclass(frozen=True)
class Figure:
    """A figure and its 95 % interval; `why` it is not known where it is None."""

    value: float | None
    low: float = np.nan
    high: float = np.nan
    why: str = ""

    def said(self, form: str, unit: str = "") -> str:
        """For people: "12.1 Hz [11.0, 13.5]"."""
        if self.value is None:
            return f"not determined: {self.why}"
        return f"{self.value:{form}}{unit} [{self.low:{form}}, {self.high:{form}}]"


@dataclass(frozen=True)
class Margins:
    """What the present gains mean.

    Attributes
    ----------
    band_hz : where the plant is known to `TRUSTED` of itself.
    crossover_hz, phase_deg, gain_db, delay_ms : where the loop's gain is one; margins there and at -180 deg.
    ms : the largest sensitivity inside the band: how much disturbances grow at worst.
    bandwidth_hz : where the answer to the setpoint falls to -3 dB.
    noise : the largest gain from measurement noise to the controller's output, inside the band.
    """

    band_hz: tuple[float, float]
    crossover_hz: Figure
    phase_deg: Figure
    gain_db: Figure
    delay_ms: Figure
    ms: Figure
    bandwidth_hz: Figure
    noise: Figure


def trusted_band(loop: Loop, *, lowest_hz: float = 1.5) -> tuple[float, float]:
    """The widest stretch of frequencies, Hz, from `lowest_hz` on in which the plant is known.

    `lowest_hz`: below, the window bends the plant by more than 4 %, before that is taken off.

    Raises
    ------
    DataError : there is none: the sticks did not move the vehicle enough.
    """
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
    if last - first <= POWERS:  # no more lines than `smoothed` has coefficients
        raise DataError(
            f"the plant is known between {loop.f[first]:.0f} and {loop.f[last]:.0f} Hz alone",
            hint="fly quick stick movements on this axis, a minute of them, in calm air",
        )
    return float(loop.f[first]), float(loop.f[last])


def margins(loop: Loop, controller: Controller) -> Margins:
    """The figures of one loop.

    Raises
    ------
    DataError : the plant is not known anywhere, or not where the loop's gain is one.
    """
    low, high = trusted_band(loop)
    at = (loop.f >= low) & (loop.f <= high)
    f = loop.f[at]
    back = controller.feedback(f)
    forward = controller.reference(f)
    centre, draws = smoothed(loop, at)
    one = _figures(f, centre, back, forward)
    if np.isnan(one[0]):
        raise DataError(
            f"the loop's gain is not one between {low:.0f} and {high:.0f} Hz, the band in which "
            "the plant is known",
            hint="fly quicker stick movements: steps and flicks, on this axis",
        )
    every = np.array([_figures(f, g, back, forward) for g in draws])
    blocks = sum(len(b) for b in loop.blocks)
    beyond = f"above {high:.0f} Hz, which the sticks do not excite"
    named = [_figure(value, column, beyond, blocks) for value, column in zip(one, every.T, strict=True)]
    return Margins((low, high), *named)


def smoothed(loop: Loop, at: npt.NDArray[np.bool_]) -> tuple[ComplexArray, ComplexArray]:
    """The plant (F,) at these lines and its draws (D, F), without scatter from line to line and without bend.

    ln G is of fourth degree in ln f, its phase with a delay beside, by least squares weighted with the draws'
    scatter: a largest value, as Ms is, of a ragged curve would be too large. The weight of a line is that of
    its neighbours: by its own scatter, lines would be preferred for their errors.

    A Hann window of T seconds averages spectra over frequency with the variance 1 / (3 T^2), so that the
    quotient of S_ry = G S_ru and S_ru comes out as G (1 + (G'' / G + 2 G' / G S_ru' / S_ru) / (6 T^2)). That
    is taken off; derivatives are those of the smooth curves.
    """
    f = loop.f[at]
    centre = plant(loop.mean)[at]
    away = np.log(plant(loop.draws)[:, at] / centre)
    scatter = median_filter((np.abs(away) ** 2).mean(axis=0), NEIGHBOURS, mode="nearest")
    curves = _Curves.at(f, 1.0 / np.sqrt(np.maximum(scatter, 1e-8)))
    level, slope, second = curves.of(centre)
    _, sent, _ = curves.of(loop.mean[0, 1][at])
    window_s = 1.0 / (loop.f[1] - loop.f[0])
    bend = (second + slope**2 + 2.0 * slope * sent) / (6.0 * window_s**2)
    middle = np.exp(level) / (1.0 + bend)
    return middle, middle * np.exp(curves.through(away))


@dataclass(frozen=True, eq=False)
class _Curves:
    """Fits of ln G by powers of ln f, and of its phase by those and f.

    Attributes
    ----------
    basis : (3, F, POWERS + 1) the functions, f the last, and their first and second derivatives by f.
    size, turn : (POWERS, F), (POWERS + 1, F) that take ln |G| and the phase to coefficients.
    """

    basis: FloatArray
    size: FloatArray
    turn: FloatArray

    @classmethod
    def at(cls, f: FloatArray, weight: FloatArray) -> _Curves:
        x = np.log(f / np.sqrt(f[0] * f[-1]))[:, None]
        n = np.arange(POWERS)
        by_x = n * x ** np.maximum(n - 1, 0)
        twice = n * (n - 1) * x ** np.maximum(n - 2, 0)
        g = f[:, None]
        rows = [
            np.column_stack(pair)
            for pair in ((x**n, f), (by_x / g, np.ones_like(f)), ((twice - by_x) / g**2, np.zeros_like(f)))
        ]
        weighted = rows[0] * weight[:, None]
        return cls(
            np.array(rows), np.linalg.pinv(weighted[:, :POWERS]) * weight, np.linalg.pinv(weighted) * weight
        )

    def of(self, values: ComplexArray) -> ComplexArray:
        """(3, F) the fit of ln values and its first and second derivatives."""
        size = self.basis[:, :, :POWERS] @ (self.size @ np.log(np.abs(values)))
        return np.asarray(size + 1j * (self.basis @ (self.turn @ np.unwrap(np.angle(values)))))

    def through(self, away: ComplexArray) -> ComplexArray:
        """(D, F) the fits of logarithms."""
        size = self.basis[0, :, :POWERS] @ self.size
        return np.asarray(away.real @ size.T + 1j * (away.imag @ (self.basis[0] @ self.turn).T))


def _figures(f: FloatArray, g: ComplexArray, back: ComplexArray, forward: ComplexArray) -> list[float]:
    """In the order of `Margins`; NaN for what is not reached."""
    loop = g * back
    size = np.log(np.abs(loop))
    turn = np.unwrap(np.angle(loop))
    turn -= (
        2.0 * np.pi * np.round((turn[0] + 0.5 * np.pi) / (2.0 * np.pi))
    )  # an integrator's -90 deg at first
    crossover = _falls(f, size)
    phase = 180.0 + np.degrees(np.interp(crossover, f, turn)) if np.isfinite(crossover) else np.nan
    turned = _falls(f, turn + np.pi)
    gain = -DB * np.interp(turned, f, size) if np.isfinite(turned) else np.nan
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
    ]


def _falls(f: FloatArray, values: FloatArray) -> float:
    """The last frequency at which values fall through zero; NaN where they do not."""
    down = np.flatnonzero((values[:-1] > 0.0) & (values[1:] <= 0.0))
    if not len(down):
        return np.nan
    k = int(down[-1])
    share = values[k] / (values[k] - values[k + 1])
    return float(np.exp((1.0 - share) * np.log(f[k]) + share * np.log(f[k + 1])))


def _figure(value: float, draws: FloatArray, beyond: str, blocks: int) -> Figure:
    """With its interval; not determined where any draw does not reach it: the interval would be cut off.

    Half the width is Student's t times the draws' standard deviation: a resample of B blocks scatters less
    than the blocks do.
    """
    if np.isnan(value) or not np.isfinite(draws).all():
        return Figure(None, why=beyond)
    reach = float(stdtrit(blocks - 1, 0.975) * draws.std() * np.sqrt(blocks / (blocks - 1)))
    if value <= reach:
        return Figure(None, why="the flights scatter too much; fly longer, in calmer air")
    return Figure(value, value - reach, value + reach)
