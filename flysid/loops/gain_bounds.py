"""A rate loop by factors of its gains, and whether it keeps bounds on every plant that may be."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.loops.controller import Controller
from flysid.loops.flight_errors import HIGHEST, Errors, Noise
from flysid.loops.known_axis import KnownAxis
from flysid.loops.margins import CLEAR
from flysid.loops.stick_response import ComplexArray

EVERY_DRAW = 4
"""Of the draws of the plant, which a search looks at."""
QUANTILE = 0.975
BEYOND = 2.0
"""Times the band's end: up to there a loop is looked at, with the plant that fits."""


@dataclass(frozen=True)
class RateBounds:
    """What a loop must keep.

    `ms`: largest sensitivity.
    `noise`: root mean square of the output's noise, over that of the present settings.
    `angle_peak`: largest answer of an angle loop around it to its setpoint.
    """

    ms: float = 1.7
    noise: float = 1.5
    angle_peak: float = 1.1


@dataclass(frozen=True, eq=False)
class Terms:
    """A controller's answer, term by term, at some frequencies: P, I, D and what no factor moves.

    `back`, `forward`: (4, F) from the rate, its sign left out, and from the setpoint.
    """

    back: ComplexArray
    forward: ComplexArray

    @classmethod
    def of(cls, controller: Controller, f: FloatArray) -> Terms:
        """Of a controller, whose answer is linear in its gains."""
        bare = replace(
            controller,
            p=0.0,
            i=0.0,
            d=0.0,
            i_at_rest=None,
            forward=0.0,
            forward_slope=0.0,
            recorded_forward=None,
        )
        alone = [
            replace(bare, p=controller.p),
            replace(bare, i=controller.i),
            replace(bare, d=controller.d),
            replace(controller, p=0.0, i=0.0, d=0.0, i_at_rest=None),
        ]
        return cls(
            np.array([own.feedback(f) for own in alone]), np.array([own.reference(f) for own in alone])
        )

    def at(self, factors: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """(F,) back and forward with P, I and D by factors (3,)."""
        weights = np.append(factors, 1.0)
        return weights @ self.back, weights @ self.forward


@dataclass(frozen=True, eq=False)
class Bounded:
    """A loop whose gains are factors of a controller's.

    `f`, `plants`: (F,) Hz from the band's lower end to beyond its upper one, (D, F) draws of the plant.
    `high_hz`: the band's end.
    """

    bounds: RateBounds
    f: FloatArray
    plants: ComplexArray
    high_hz: float
    rest: Terms
    errors: Errors
    moving: Terms
    noise: Noise
    loud: Terms
    present_noise: float
    present_error: float

    @classmethod
    def of(cls, known: KnownAxis, controller: Controller, bounds: RateBounds) -> Bounded:
        """Of an axis with a controller whose filters may be other ones than those that flew."""
        low, high = known.band_hz
        lines = known.together.f
        top = min(BEYOND * high, HIGHEST * known.last.record.rate_hz)
        f = lines[(lines >= low) & (lines <= top)]
        _, plants = known.everywhere(f)
        inside = f <= high
        plants[:, inside] = known.draws
        errors, noise = Errors.of(known).of_plant(), Noise.of(known).of_plant()
        return cls(
            bounds,
            f,
            plants[::EVERY_DRAW],
            high,
            Terms.of(controller.at_rest(), f),
            errors,
            Terms.of(controller, errors.f),
            noise,
            Terms.of(controller, noise.f),
            float(noise.under(known.last.controller)[0]),
            float(errors.under(known.last.controller)[0]),
        )

    def cost(self, factors: FloatArray) -> float:
        """Log of the error over that of the present settings, and a penalty for what the bounds forbid."""
        return float(np.log(self.error(factors)) + PENALTY * self.excess(factors))

    def error(self, factors: FloatArray) -> float:
        """Over that of the present settings."""
        return float(self.errors.between(*self.moving.at(factors))[0]) / self.present_error

    def excess(self, factors: FloatArray) -> float:
        """By how much bounds are passed, all of them added; 0 where the loop keeps them."""
        return float(sum(self.passed(factors).values()))

    def passed(self, factors: FloatArray) -> dict[str, float]:
        """By how much each bound is passed: logs of the quotients, and the share of unstable plants."""
        back, _ = self.rest.at(factors)
        loop = self.plants * back
        ms = np.quantile(np.abs(1.0 / (1.0 + loop)).max(axis=1), QUANTILE)
        noise = float(self.noise.between(self.loud.at(factors)[0])[0]) / self.present_noise
        crossing, stable = _crossings(self.f, loop)
        late = np.quantile(crossing, QUANTILE) * CLEAR / self.high_hz
        over = {"ms": ms / self.bounds.ms, "noise": noise / self.bounds.noise, "crossover": late}
        found = {name: max(0.0, float(np.log(value))) for name, value in over.items()}
        return found | {"stability": 1.0 - float(np.mean(stable))}


PENALTY = 100.0
"""Of a bound passed by 1 %, an error larger by as much again: no bound is worth it."""


def _crossings(f: FloatArray, loop: ComplexArray) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """(D,) Hz where the gain is last 1, and whether the loop has turned by less than 180 deg there."""
    large = np.abs(loop) >= 1.0
    last = loop.shape[1] - 1 - np.argmax(large[:, ::-1], axis=1)
    last = np.where(large.any(axis=1), last, 0)
    turn = np.unwrap(np.angle(loop), axis=1)
    turn -= 2.0 * np.pi * np.round((turn[:, :1] + 0.5 * np.pi) / (2.0 * np.pi))
    return f[last], turn[np.arange(len(loop)), last] > -np.pi
