"""Figures of a step response, each with its interval: latency, rise, overshoot, settling, final value.

They are read off the mean of a posterior and off draws of it, as a whole (`loop_curve.interval`). Times are
known to half a sample at best, and what takes less than one is a bound. Where the response has not settled
within its length, none of them is a figure of a step that goes on: they are refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.frequency.loop_curve import interval
from flysid.model.polynomials import CONFIDENCE, Z95
from flysid.showing import significant

DRAWS = 400
WITHIN = 0.05
"""Of the final value: what counts as settled, as PID analysers have it."""
_NAMES = (("latency", "ms"), ("rise", "ms"), ("overshoot", "%"), ("settling", "s"))


@dataclass(frozen=True)
class StepFigure:
    """One figure of a step response with its 95 % interval; `value` is None where it has none (`why`).

    With a `high` beside it, a figure without value is a bound: it lies below `high`.
    """

    name: str
    unit: str
    value: float | None
    low: float | None = None
    high: float | None = None
    why: str = ""

    def __str__(self) -> str:
        if self.value is None or self.low is None or self.high is None:
            return f"{self.name}: {self.why}"
        return (
            f"{self.name} {significant(self.value)} {self.unit}".rstrip()
            + f" [{significant(self.low)}, {significant(self.high)}]"
        )

    def to_dict(self) -> dict[str, float | str | None]:
        """JSON types only."""
        return {"unit": self.unit, "value": self.value, "low": self.low, "high": self.high, "why": self.why}


@dataclass(frozen=True, eq=False)
class StepCurve:
    """Mean (N,) and covariance (N, N) of a step on times (N,), and the output's unit."""

    time_s: FloatArray
    step: FloatArray
    covariance: FloatArray
    unit: str

    @property
    def figures(self) -> tuple[StepFigure, ...]:
        """All of a response that has settled, in order; final value last."""
        curves = self._curves()
        final = _figure("final value", self.unit, _finals(curves), self._drift, least=-np.inf)
        if final.low is None or final.high is None or final.low <= 0.0 <= final.high:
            why = "the step's final value cannot be told from 0"
            return (*(StepFigure(n, u, None, why=why) for n, u in _NAMES), final)
        scaled = curves / _finals(curves)[:, None]
        grain = 0.5 * self.sample_s
        ten = _each(scaled, partial(_first_time, self.time_s, 0.1))
        ninety = _each(scaled, partial(_first_time, self.time_s, 0.9))
        drift = 100.0 * self._drift / abs(final.value or 1.0)
        return (
            self._no_finer(_figure("latency", "ms", 1e3 * ten, 1e3 * grain), 1e3),
            self._no_finer(_figure("rise", "ms", 1e3 * (ninety - ten), 1e3 * grain), 1e3),
            _figure("overshoot", "%", _each(scaled, _overshoot), drift),
            self._no_finer(_figure("settling", "s", _each(scaled, self._settle), grain), 1.0),
            final,
        )

    @property
    def unsettled(self) -> tuple[StepFigure, ...]:
        """All of a response of which nothing tells what a longer step does."""
        why = f"not settled within {significant(self.time_s[-1] + self.sample_s)} s; it goes on, or longer "
        why += "flights have to show that it does not"
        return tuple(StepFigure(n, u, None, why=why) for n, u in (*_NAMES, ("final value", self.unit)))

    @property
    def sample_s(self) -> float:
        """Between two times."""
        return float(self.time_s[1] - self.time_s[0])

    @property
    def is_settled(self) -> bool:
        """The second half keeps within half of WITHIN of the final value, as far as chance shows it.

        Chance excuses no more than twice WITHIN, nor a band that is wider than half of the response: a ramp
        of which little is known would look settled.
        """
        half = len(self.step) // 2
        off = np.abs(self.step[half:] - _finals(self.step[None])[0])
        chance = Z95 * np.sqrt(np.maximum(np.diag(self.covariance)[half:], 0.0))
        largest = float(np.abs(self.step).max())
        allowed = np.minimum(0.5 * WITHIN * largest + chance, 2.0 * WITHIN * largest)
        return bool(
            (off <= allowed).all()
            and (chance <= 0.25 * largest).all()
            and self._drift <= 0.5 * WITHIN * largest
        )

    @property
    def _drift(self) -> float:
        """How far the mean of the last tenth is from that of the tenth before."""
        tenth = max(len(self.step) // 10, 1)
        return float(abs(self.step[-tenth:].mean() - self.step[-2 * tenth : -tenth].mean()))

    def _curves(self) -> FloatArray:
        """(2 + D, N) the mean, again the mean, and draws, as `interval` takes them."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        draws = self.step + np.random.default_rng(0).standard_normal((DRAWS, len(root))) @ root.T
        return np.vstack([self.step, self.step, draws])

    def _no_finer(self, figure: StepFigure, unit: float) -> StepFigure:
        """A time below one sample is a bound."""
        sample = unit * self.sample_s
        if figure.value is None or figure.high is None or figure.value >= sample:
            return figure
        high = max(figure.high, sample)
        why = f"below {significant(high)} {figure.unit} (one sample is {significant(sample)} {figure.unit})"
        return StepFigure(figure.name, figure.unit, None, 0.0, high, why)

    def _settle(self, step: FloatArray) -> float:
        """The last time at which a step of final value 1 is out of bounds, between samples by a line."""
        off = np.abs(step - 1.0)
        outside = np.flatnonzero(off > WITHIN)
        if not len(outside):
            return float(self.time_s[0])
        k = int(outside[-1])
        if k >= 0.9 * len(step):
            return np.nan
        share = (off[k] - WITHIN) / max(off[k] - off[k + 1], 1e-12)
        return float(self.time_s[k] + share * self.sample_s)


def _figure(name: str, unit: str, values: FloatArray, grain: float, least: float = 0.0) -> StepFigure:
    """A figure of the mean and of the draws (2 + D,), none of it below `least`.

    `grain`: what else it may be off.
    """
    found = interval(values)
    if found is None:
        return StepFigure(name, unit, None, why="not reached within the response's length")
    value, low, high = found
    # where a figure jumps, as settling does from one swing to the next, the draws themselves tell how far
    tail = 0.5 * (1.0 - CONFIDENCE)
    own = np.quantile(values[np.isfinite(values)], [tail, 1.0 - tail])
    low, high = min(low, own[0]), max(high, own[1])
    value = max(value, least)
    low, high = value - np.hypot(value - low, grain), value + np.hypot(high - value, grain)
    return replace(StepFigure(name, unit, value), low=max(float(low), least), high=float(high))


def _each(curves: FloatArray, figure: Callable[[FloatArray], float]) -> FloatArray:
    return np.array([figure(c) for c in curves])


def _finals(curves: FloatArray) -> FloatArray:
    """(K,) means of the last tenth."""
    return np.asarray(curves[:, -max(curves.shape[1] // 10, 1) :].mean(axis=1))


def _overshoot(step: FloatArray) -> float:
    """Percent above a final value of 1, by the parabola through the largest sample and its neighbours."""
    k = int(np.argmax(step))
    apex = float(step[k])
    if 0 < k < len(step) - 1:  # at an edge there is no parabola but one that leaves the samples
        before, middle, after = step[k - 1 : k + 2]
        bend = before - 2.0 * middle + after
        apex -= (after - before) ** 2 / (8.0 * min(bend, -1e-12))
    return 100.0 * max(apex - 1.0, 0.0)


def _first_time(time_s: FloatArray, share: float, step: FloatArray) -> float:
    above = np.flatnonzero(step >= share)
    if not len(above):
        return np.nan
    k = int(above[0])
    if k == 0:
        return float(time_s[0])
    part = (share - step[k - 1]) / max(step[k] - step[k - 1], 1e-12)
    return float(time_s[k - 1] + part * (time_s[k] - time_s[k - 1]))
