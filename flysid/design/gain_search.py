"""Gains that serve the worst plant best, within bounds that every plant must keep.

Differential evolution over the logarithms (a population at a time is one array), then Nelder and Mead. Gains
out of bounds cost more the farther out they are, and always more than any inside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.design.drawn_plants import PlantSet
from flysid.design.law import TUNED, Gains, LoopParts
from flysid.design.loopfigures import Figures, Laws, figures
from flysid.errors import DataError, UsageError

OUT_OF_BOUNDS = 1e6
"""Least cost of gains that break a bound; those inside cost at most this."""


@dataclass(frozen=True)
class Bounds:
    """What every plant must keep.

    `ms`: largest amplification of disturbances.
    `peak`: largest gain from reference to position.
    `noise`: input per m/s of noise in the velocity.
    `crossover_rad_s`: of the loop at the plant's input.
    `push`: step at the plant's input whose error counts like that of a step of 1 m in the reference.
    """

    ms: float = 1.6
    peak: float = 1.15
    noise: float = 30.0
    crossover_rad_s: float = 10.0
    push: float = 1.5

    def __post_init__(self) -> None:
        if not (self.ms > 1.0 and self.peak > 1.0 and self.noise > 0.0 and self.crossover_rad_s > 0.0):
            raise UsageError("bounds on Ms and on the peak are above 1, the others above 0")

    def excess(self, found: Figures) -> FloatArray:
        """(S,) how far the worst plant is out of bounds; 0 inside, at least 1 where a loop is unstable."""
        over = [
            np.log(found.ms / self.ms),
            np.log(found.peak / self.peak),
            np.log(found.noise / self.noise),
            np.log(np.maximum(found.crossover, 1e-9) / self.crossover_rad_s),
        ]
        worst = np.max([np.maximum(o, 0.0).max(axis=1) for o in over], axis=0)
        return np.asarray(np.where(found.stable.all(axis=1), worst, 1.0 + worst))

    def cost(self, found: Figures) -> FloatArray:
        """(S,) squared error of the worst plant, m^2 s; any set of gains out of bounds costs more."""
        error = (found.tracking + self.push**2 * found.disturbance).max(axis=1)
        over = self.excess(found)
        return np.asarray(
            np.where(over > 0.0, OUT_OF_BOUNDS * (1.0 + over), np.minimum(error, OUT_OF_BOUNDS))
        )


@dataclass(frozen=True)
class Box:
    """Smallest and largest of every gain that is searched for; a gain whose two are equal stands still.

    `beyond`: of (S, 5) gains, (S,) how far they are outside in another way; 0 inside.
    """

    low: Gains
    high: Gains
    beyond: Callable[[FloatArray], FloatArray] | None = None

    @classmethod
    def around(cls, present: Gains, factor: float, beyond: Callable[[FloatArray], FloatArray]) -> Box:
        """About the present gains: parameters move by at most a factor, and a gain that is 0 stays 0.

        `beyond`: how far parameters, which may be products of gains, move by more than that.
        """
        names = {name: getattr(present, name) for name in TUNED if name != "cut_hz"}
        wide = factor * factor
        return cls(
            replace(present, **{name: value / wide for name, value in names.items()}),
            replace(present, **{name: value * wide for name, value in names.items()}),
            beyond,
        )

    @classmethod
    def free(cls, plants: PlantSet, bounds: Bounds, like: Gains, *, with_filter: bool) -> Box:
        """All that could make sense: nothing faster than the crossover allows, nothing noisier than allowed.

        `like`: gains of the same kind of controller.
        `with_filter`: the derivative's filter is free, too.
        """
        fast = bounds.crossover_rad_s
        slow = plants.omega[0]
        most = bounds.noise
        little = 1e-3 * most
        cut = fast / (2.0 * np.pi)
        low = replace(like, position=slow, velocity=little, integral=little * slow, derivative=little / fast)
        high = replace(like, position=fast, velocity=most, integral=most * fast, derivative=most / fast)
        if not with_filter:
            return cls(low, high)
        return cls(replace(low, cut_hz=cut), replace(high, cut_hz=0.25 / plants.dt_s))


def search(plants: PlantSet, bounds: Bounds, box: Box, seed: int = 0) -> Gains:
    """The gains in a box that cost the worst plant least.

    Raises DataError: no gains in the box keep the bounds on every plant.
    """
    from scipy.optimize import differential_evolution, minimize

    low = box.low.tuned()
    high = box.high.tuned()
    moving = high > low
    parts = LoopParts.at(plants.omega, plants.dt_s)

    def cost(every: FloatArray) -> FloatArray:
        own = bounds.cost(figures(Laws.of(box.low, every), plants.responses, parts))
        outside = np.zeros(len(every)) if box.beyond is None else box.beyond(every)
        return np.asarray(np.where(outside > 0.0, OUT_OF_BOUNDS * (2.0 + outside), own))

    def of(points: FloatArray) -> FloatArray:
        every = np.tile(low, (points.shape[1], 1))
        every[:, moving] = np.exp(points.T)
        return cost(every)

    limits = list(zip(np.log(low[moving]), np.log(high[moving]), strict=True))
    first = differential_evolution(
        of,
        limits,
        rng=seed,
        vectorized=True,
        updating="deferred",
        popsize=12,
        maxiter=60,
        tol=1e-3,
        polish=False,
    )
    last = minimize(
        lambda x: float(of(np.clip(x, *np.transpose(limits))[:, None])[0]),
        first.x,
        method="Nelder-Mead",
        options={"maxfev": 300, "xatol": 1e-3, "fatol": 1e-5},
    )
    best = np.clip(last.x, *np.transpose(limits))
    values = low.copy()
    values[moving] = np.exp(best)
    if cost(values[None])[0] >= OUT_OF_BOUNDS:
        raise DataError(
            "no gains keep Ms, peak, noise and crossover within bounds on all plants",
            hint="allow more (--ms, --noise), or a smaller spread of gain and delay",
        )
    return replace(box.low, **dict(zip(TUNED, map(float, values), strict=True)))
