"""Has a vehicle left the behaviour of its model? Three statistics of a stream, and thresholds for them.

    cusum   two-sided cumulative sum of the one-step error's mean (Page, 1954): the default
    glr     the same against a step of unknown size within the last 20 s (Willsky and Jones, 1976), windows
            doubling from one sample on: quicker on large steps
    level   mean over 5 s of measured less free run, the free run begun 10 s ago, or with the stream where it
            is younger: a one-step error has the measured output in it and forgets what was wrong from
            take-off, the free run does not

One-step errors in flight are neither white nor Gaussian (wind), so no textbook threshold keeps its promise.
Thresholds come from held-out flights: largest values per block of time, an exponential tail fitted to those
above their upper quartile (Coles, An Introduction to Statistical Modeling of Extreme Values, 2001, with
shape 0), its scale taken at the upper end of its 95 % interval. Blocks of one flight share its wind, so that
the interval counts flights, not blocks.
Basseville and Nikiforov, Detection of Abrupt Changes, 1993, chapters 2, 5 and 11.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from flysid.compiling import njit
from flysid.dataset import FloatArray, Segment
from flysid.errors import DataError
from flysid.model.base import Fitted

DETECTORS = ("cusum", "glr", "level")
HALF_STEP = 0.5  # the CUSUM is quickest on steps of one standard deviation beyond what wanders anyway
GLR_S = 20.0
LEVEL_S = 5.0
RUN_S = 10.0
LEVEL_EVERY_S = 0.5
BLOCK_S = 60.0
SHORT_BLOCK_S = 10.0
ENOUGH_BLOCKS = 20


@dataclass
class Sums:
    """CUSUM and GLR of one output while its errors come in; `feed` goes on where it stopped.

    `drift`: of the CUSUM, in standard deviations.
    `longest`: samples of the longest GLR window.
    """

    drift: float
    longest: int
    _state: FloatArray = field(default_factory=lambda: np.zeros(4))
    _count: int = 0

    def __post_init__(self) -> None:
        self._ring = np.zeros(self.longest + 1)

    def feed(self, errors: FloatArray) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        """Statistics (n, 2) of errors in standard deviations; since how many samples the CUSUM (n,) grows.

        The CUSUM has the sign of the side that is larger.
        """
        stats = np.empty((len(errors), 2))
        since = np.empty(len(errors), np.int64)
        self._count = _feed(
            np.ascontiguousarray(errors), self.drift, self._state, self._ring, self._count, stats, since
        )
        return stats, since

    def forget(self) -> None:
        """Begin anew."""
        self._state[:] = 0.0
        self._ring[:] = 0.0
        self._count = 0


@njit(cache=True)
def _feed(  # type: ignore[no-untyped-def]
    errors: FloatArray,
    drift: float,
    state: FloatArray,
    ring: FloatArray,
    count: int,
    stats: FloatArray,
    since,
) -> int:
    """state: sums up and down, and since how many samples each grows; ring: running total of errors."""
    size = len(ring)
    for i in range(len(errors)):
        for side in range(2):
            step = (errors[i] if side == 0 else -errors[i]) - drift
            state[side] = max(0.0, state[side] + step)
            state[2 + side] = state[2 + side] + 1 if state[side] > 0.0 else 0.0
        total = ring[count % size] + errors[i]
        count += 1
        ring[count % size] = total
        largest = 0.0
        window = 1
        while window < size and window <= count:
            part = total - ring[(count - window) % size]
            largest = max(largest, part * part / (2.0 * window))
            window *= 2
        down = state[1] > state[0]
        stats[i, 0] = -state[1] if down else state[0]
        stats[i, 1] = largest
        since[i] = np.int64(state[3] if down else state[2])
    return count


@dataclass(frozen=True)
class Thresholds:
    """What an output's statistics may reach, and what they are measured in.

    `sigma`: standard deviation of the one-step error, in the output's unit.
    `drift`: of the CUSUM, in sigma.
    `cusum`, `glr`, `level`: thresholds; the level's is in the output's unit.
    `band`: half width around the free run that holds 99.5 % of nominal samples, in the output's unit.
    `typical`: mean of the output's absolute value, for shares.
    `hours`: of held-out flight that they rest on.
    """

    sigma: float
    drift: float
    cusum: float
    glr: float
    level: float
    band: float
    typical: float
    hours: float


def calibrate(model: Fitted, segments: Sequence[Segment], false_alarms_1_h: float) -> tuple[Thresholds, ...]:
    """Thresholds for each output of a model from flights that it has not seen.

    `false_alarms_1_h`: false alarms an hour that one detector of one output may raise.
    Raises DataError: too little held-out flight.
    """
    usable = [s for s in segments if len(s) * model.dt_s > RUN_S + SHORT_BLOCK_S]
    hours = sum(map(len, usable)) * model.dt_s / 3600.0
    block_s = BLOCK_S if hours * 3600.0 / BLOCK_S >= 2 * ENOUGH_BLOCKS else SHORT_BLOCK_S
    found = []
    errors = [one_step(model, s.u, s.y)[model.n_init :] for s in usable]
    runs = [levels(model, s.u, s.y) for s in usable]
    for j in range(len(model.outputs)):
        if not usable or hours * 3600.0 / block_s < ENOUGH_BLOCKS:
            held = sum(map(len, segments)) * model.dt_s
            raise DataError(
                f"{held:.0f} s of held-out flight, {3600 * hours:.0f} s of it in stretches above "
                f"{RUN_S + SHORT_BLOCK_S:.0f} s, are too little to calibrate alarms on: that takes "
                f"{ENOUGH_BLOCKS * SHORT_BLOCK_S:.0f} s",
                hint="fit with longer flights, or more of them; or hold out a larger share (--holdout 0.5)",
            )
        mine = [e[:, j] for e in errors]
        sigma = float(np.std(np.concatenate(mine))) or 1e-12
        drift = HALF_STEP + wander([e / sigma for e in mine], round(LEVEL_S / model.dt_s))
        block = max(1, round(block_s / model.dt_s))
        tops: list[list[list[float]]] = [[], [], []]
        for e, run in zip(mine, runs, strict=True):
            stats, _ = Sums(drift, round(GLR_S / model.dt_s)).feed(e / sigma)
            tops[0].append(block_maxima(np.abs(stats[:, 0]), block))
            tops[1].append(block_maxima(stats[:, 1], block))
            tops[2].append(block_maxima(np.abs(run.level[:, j]), max(1, round(block_s / LEVEL_EVERY_S))))
        cusum, glr, level = (threshold(t, block_s, false_alarms_1_h) for t in tops)
        band = float(np.quantile(np.abs(np.concatenate([r.last[:, j] for r in runs])), 0.995))
        typical = float(np.mean(np.abs(np.concatenate([s.y[:, j] for s in usable]))))
        found.append(Thresholds(sigma, drift, cusum, glr, level, band, typical, hours))
    return tuple(found)


def wander(errors: Sequence[FloatArray], samples: int) -> float:
    """How far the errors' mean over so many samples strays in 95 of 100 cases."""
    means = [np.abs(e[: len(e) // samples * samples].reshape(-1, samples).mean(axis=1)) for e in errors]
    return float(np.quantile(np.concatenate(means), 0.95))


def block_maxima(values: FloatArray, block: int) -> list[float]:
    """The largest value of each whole block."""
    return [float(v) for v in values[: len(values) // block * block].reshape(-1, block).max(axis=1)]


def threshold(maxima: Sequence[Sequence[float]], block_s: float, per_hour: float) -> float:
    """What blocks of so many seconds exceed so often in an hour, by an exponential tail.

    `maxima`: of each flight, the largest value of each of its blocks.
    """
    every = np.concatenate([np.asarray(flight, dtype=np.float64) for flight in maxima])
    edge = float(np.quantile(every, 0.75))
    beyond = every[every > edge] - edge
    if not len(beyond):
        return edge
    flights = sum(any(top > edge for top in flight) for flight in maxima)
    scale = float(beyond.mean()) * 2 * flights / float(chdtri(2 * flights, 0.95))
    expected = 3600.0 / block_s * len(beyond) / len(every)
    return edge + scale * max(0.0, math.log(expected / per_hour))


def one_step(model: Fitted, u: FloatArray, y: FloatArray) -> FloatArray:
    """(N, n_y) measured less predicted one step ahead; 0 where there is no prediction yet."""
    return np.asarray(np.nan_to_num(y - model.predict(u, y, 1)))


@dataclass(frozen=True, eq=False)
class Levels:
    """Free runs begun `RUN_S` ago, or where the segment begins, ended every `LEVEL_EVERY_S`.

    `at`: (m,) index of the last sample of each.
    `level`: (m, n_y) mean over `LEVEL_S` of measured less free run.
    `last`: (m, n_y) the same at the last sample.
    """

    at: npt.NDArray[np.int64]
    level: FloatArray
    last: FloatArray


def levels(model: Fitted, u: FloatArray, y: FloatArray) -> Levels:
    """The free run's levels along a segment."""
    every = max(1, round(LEVEL_EVERY_S / model.dt_s))
    at = np.arange(shortest_run(model), len(y) + 1, every) - 1
    found = [level_at_end(model, y[: k + 1], run_at_end(model, u[: k + 1], y[: k + 1])) for k in at.tolist()]
    shape = (len(at), y.shape[1])
    return Levels(
        at,
        np.array([f[0] for f in found]).reshape(shape),
        np.array([f[1] for f in found]).reshape(shape),
    )


def run_samples(model: Fitted) -> int:
    """Samples that a free run of `RUN_S` takes, those included that it starts from."""
    return model.n_init + max(2, round(RUN_S / model.dt_s))


def shortest_run(model: Fitted) -> int:
    """Samples after which a free run has a level, those included that it starts from."""
    return model.n_init + max(2, round(LEVEL_S / model.dt_s))


def run_at_end(model: Fitted, u: FloatArray, y: FloatArray) -> FloatArray:
    """(n, n_y) the free run that ends with these samples, begun `RUN_S` ago or with the first of them."""
    n = run_samples(model)
    return model.simulate(u[-n:], y[-n:][: model.n_init])


def level_at_end(model: Fitted, y: FloatArray, free: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n_y,) level and (n_y,) last difference of a free run that ends with these samples."""
    apart = y[-len(free) :] - free
    return apart[-max(1, round(LEVEL_S / model.dt_s)) :].mean(axis=0), apart[-1]
