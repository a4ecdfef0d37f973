"""What a closed loop would be under other gains: the plant of some flights, the controller of another.

Plants differ from flight to flight (battery, air, throttle) by more than one flight's own scatter tells. The
band of a prediction is therefore made of the differences among the flights, by Student's t with one degree of
freedom less than there are flights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.loops.controller import Controller
from flysid.loops.margins import smooth, trusted_band
from flysid.loops.stick_response import DRAWS, ComplexArray, Loop, plant

FEW_POWERS = 3


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
            f"{len(flights)} flights are too few to estimate the scatter between flights",
            hint="give three flights or more",
        )
    f = flights[0].f
    together = Loop(f, tuple(blocks for x in flights for blocks in x.blocks))
    pooled = plant(together.mean)
    apart = np.log(np.array([plant(x.mean) / pooled for x in flights]))
    n = len(flights)
    rng = np.random.default_rng(0)
    weights = rng.standard_normal((DRAWS, n)) * np.sqrt((1.0 + 1.0 / n) / (n - 1))
    weights *= np.sqrt((n - 1) / rng.chisquare(n - 1, DRAWS))[:, None]
    low, high = trusted_band(together)
    at = (f >= low) & (f <= high)
    pooled[at], _ = smooth(together, at, FEW_POWERS)
    draws = pooled * np.exp(weights @ apart)
    return Prediction(f, _close(pooled, f, controller), _close(draws, f, controller))


def _close(g: ComplexArray, f: FloatArray, controller: Controller) -> ComplexArray:
    return np.asarray(g * controller.reference(f) / (1.0 + g * controller.feedback(f)))
