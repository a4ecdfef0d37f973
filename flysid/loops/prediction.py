"""What a closed loop would be under other gains: the plant of some flights, the controller of another.

Where the controller is known step by step (Betaflight), the flight itself is flown again with the plant that
the motors show, and its response is measured like that of a real flight.

Plants differ from flight to flight (battery, air, throttle) by more than one flight's own scatter tells. The
band of a prediction is therefore made of the differences among the flights, by Student's t with one degree of
freedom less than there are flights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.loops.betaflight import Conditions
from flysid.loops.controller import Controller
from flysid.loops.flown_axis import FlownAxis, Turning
from flysid.loops.margins import FEW_POWERS, NEIGHBOURS, smooth, trusted_band
from flysid.loops.stick_response import DRAWS, ComplexArray, Loop, closed_loop, plant


@dataclass(frozen=True, eq=False)
class Prediction:
    """From setpoint to rate at frequencies f (Hz): (F,) the response, and (DRAWS, F) what else it may be."""

    f: FloatArray
    response: ComplexArray
    draws: ComplexArray

    def radius(self, level: float = 0.95) -> FloatArray:
        """(F,) distance from `response` within which a share `level` of the draws lies."""
        return np.asarray(np.quantile(np.abs(self.draws - self.response), level, axis=0))


def predict(flights: Sequence[Loop], controller: Controller) -> Prediction:
    """The closed loop under a controller, from flights of the same vehicle under any gains.

    Inside the band in which the plant of all flights together is known, its curve is smooth (`smooth`), of
    few powers: flights differ by more than those bend it.

    Raises
    ------
    DataError : fewer than three flights: how much plants differ is not known; or the sticks did not move the
        vehicle enough.
    """
    if len(flights) < 3:
        raise DataError(
            f"too few flights to estimate the scatter between them: {len(flights)}",
            hint="give three flights or more",
        )
    f = flights[0].f
    together = Loop(f, tuple(blocks for x in flights for blocks in x.blocks))
    pooled = plant(together.mean)
    apart = np.log(np.array([plant(x.mean) / pooled for x in flights]))
    weighed = weights(len(flights))
    low, high = trusted_band(together)
    at = (f >= low) & (f <= high)
    pooled[at], _ = smooth(together, at, FEW_POWERS)
    draws = pooled * np.exp(weighed @ apart)
    return Prediction(f, _close(pooled, f, controller), _close(draws, f, controller))


def _close(g: ComplexArray, f: FloatArray, controller: Controller) -> ComplexArray:
    return np.asarray(g * controller.reference(f) / (1.0 + g * controller.feedback(f)))


def weights(n: int) -> FloatArray:
    """(DRAWS, n) of the differences of n flights, for one more flight: Student's t, not a normal spread."""
    rng = np.random.default_rng(0)
    drawn = rng.standard_normal((DRAWS, n)) * np.sqrt((1.0 + 1.0 / n) / (n - 1))
    return np.asarray(drawn * np.sqrt((n - 1) / rng.chisquare(n - 1, DRAWS))[:, None])


@dataclass(frozen=True, eq=False)
class Turnings:
    """The plant of some flights together, and of each of them.

    `f`: (F,) Hz of the flights' responses.
    `window_s`: of the responses.
    `band_hz`: in which the plants were fitted.
    """

    f: FloatArray
    window_s: float
    band_hz: tuple[float, float]
    together: Turning
    each: tuple[Turning, ...]

    @classmethod
    def of(
        cls,
        flights: Sequence[FlownAxis],
        window_s: float = 2.0,
        band_hz: tuple[float, float] | None = None,
    ) -> Turnings:
        """Of flights of one vehicle, from what the motors were given to the rate.

        `band_hz`: where to fit; None: where the plant of all flights together is known.
        Raises DataError: the sticks did not move the vehicle enough.
        """
        loops = [Loop.of([flight.record()], window_s) for flight in flights]
        f = loops[0].f
        together = Loop(f, tuple(blocks for loop in loops for blocks in loop.blocks))
        low, high = band_hz or trusted_band(together)
        at = (f >= low) & (f <= high)
        step_s = flights[0].step_s
        found = [fit_turning(loop, at, step_s) for loop in (together, *loops)]
        return cls(f, window_s, (low, high), found[0], tuple(found[1:]))


def fit_turning(loop: Loop, at: npt.NDArray[np.bool_], step_s: float) -> Turning:
    """Least squares of ln G, weighted with its scatter."""
    from scipy.ndimage import median_filter

    g = plant(loop.mean)[at]
    away = np.abs(np.log(plant(loop.draws)[:, at] / g)) ** 2
    weight = 1.0 / np.sqrt(np.maximum(median_filter(away.mean(axis=0), NEIGHBOURS, mode="nearest"), 1e-8))

    def turning(x: FloatArray) -> Turning:
        return Turning(float(np.exp(x[0])), float(np.exp(x[1])), float(x[2]))

    def off(x: FloatArray) -> FloatArray:
        apart = weight * np.log(g / turning(x).response(loop.f[at], step_s))
        return np.concatenate([apart.real, apart.imag])

    start = np.array([np.log(50.0), np.log(0.02), 0.005])
    from scipy.optimize import least_squares

    return turning(least_squares(off, start, x_scale=(0.1, 0.1, 0.001)).x)


def predict_flight(known: Turnings, later: FlownAxis) -> Prediction:
    """The response of a flight with its own gains, sticks and throttle, from the plants of others.

    Its draws are those of its small motions about the flight as it was flown again. Raises DataError: fewer
    than two flights are known.
    """
    n = len(known.each)
    if n < 2:
        raise DataError(
            "one flight does not tell the scatter between flights", hint="give two flights or more"
        )
    response = response_of(later.fly(known.together), known.window_s)
    flown = Conditions(later.throttle, later.setpoint, later.stick, later.slower)
    back = later.law.controller(flown).feedback(known.f)

    def answer(g: ComplexArray) -> ComplexArray:
        return np.asarray(g / (1.0 + g * back))

    f = np.maximum(known.f, 1e-6)
    own = known.together.response(f, later.step_s)
    apart = np.log(np.array([turning.response(f, later.step_s) for turning in known.each]) / own)
    draws = own * np.exp(weights(n) @ apart)
    return Prediction(known.f, response, response * answer(draws) / answer(own))


def response_of(flight: FlownAxis, window_s: float) -> ComplexArray:
    """(F,) from setpoint to rate."""
    return closed_loop(Loop.of([flight.record()], window_s).mean)
