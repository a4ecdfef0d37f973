"""A rate loop under other settings, beside what it is: margins, response, step, noise, saturation.

The plant and what else it may be are those of `known_axis`; both controllers are the firmware's law. Step and
limits go by the plant that fits the measured one, as they need it where the sticks move nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.loops.controller import Controller
from flysid.loops.flight_errors import HIGHEST, NOISE_FROM_HZ, Errors, Noise
from flysid.loops.known_axis import KnownAxis
from flysid.loops.margins import Figure, list_figures
from flysid.loops.stick_response import ComplexArray, closed_loop, plant

NAMES = ("crossover_hz", "phase_deg", "gain_db", "delay_ms", "ms", "bandwidth_hz", "noise")
INSIDE = (0.025, 0.975)
STEP_RATE_HZ, STEP_LENGTH = 1000.0, 4096
SHOWN_S = 1.0
LEFT = 0.5
"""Of a step, by how much an answer may move 2 s later. That of an unstable loop comes round to there."""


@dataclass(frozen=True)
class StepFigures:
    """Of the answer to a step of the setpoint: s from a tenth to nine tenths, and how far it overshoots."""

    rise_s: Figure
    overshoot: Figure


@dataclass(frozen=True, eq=False)
class Side:
    """A loop under one set of gains.

    `gains`: as the firmware names them.
    `figures`: by name, as of `Margins`.
    `response`: (F,) from setpoint to rate, and its ends in dB and deg, (2, F) each.
    `step`: figures of the step; (N,) the answer itself, 1000 values a second.
    `limited`: share of the flight at the output's limit.
    `lost`: (D,) whether the loop is not stable with a drawn plant.
    `errors`: (1 + D,) root mean square of setpoint less rate over the last flight, of the plant and its
        draws.
    """

    gains: Mapping[str, float]
    figures: Mapping[str, Figure]
    response: ComplexArray
    db: FloatArray
    deg: FloatArray
    step: StepFigures
    answer: FloatArray
    limited: float
    lost: npt.NDArray[np.bool_]
    errors: FloatArray

    @property
    def unstable(self) -> float:
        """Share of the drawn plants with which the loop is not stable."""
        return float(np.mean(self.lost))

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        figures = {name: own.to_dict() for name, own in self.figures.items()}
        response = {
            "db": (20.0 * np.log10(np.abs(self.response))).tolist(),
            "db_interval": self.db.tolist(),
            "deg": np.degrees(np.unwrap(np.angle(self.response))).tolist(),
            "deg_interval": self.deg.tolist(),
        }
        step = {
            "rise_s": self.step.rise_s.to_dict(),
            "overshoot": self.step.overshoot.to_dict(),
            "answer": self.answer.tolist(),
        }
        rest = {"limited": self.limited, "unstable": self.unstable, "tracking_error": float(self.errors[0])}
        return {"gains": dict(self.gains), "figures": figures, "response": response, "step": step} | rest


@dataclass(frozen=True, eq=False)
class Forecast:
    """One axis under other settings.

    `flights`: whose plants it goes by.
    `next_flight`: whether the intervals hold for one more flight.
    `f`, `band_hz`: (F,) Hz of the responses, inside the band in which the plant is known.
    `before`, `after`: under the flown settings, and the new ones.
    `noise`: of the output above what the sticks move, after over before.
    `tracking`: root mean square of setpoint less rate over the last flight, after over before.
    `better`: share of the plants that fit with which it is smaller, and the loop stable.
    `off`: median error of the response under the flown settings against the measured one.
    `law`: firmware and version.
    """

    axis: str
    flights: tuple[str, ...]
    next_flight: bool
    f: FloatArray
    band_hz: tuple[float, float]
    before: Side
    after: Side
    noise: Figure
    tracking: Figure
    better: float
    off: float
    law: str

    @property
    def moved_db(self) -> float:
        """By how much the response changes, median over the band."""
        return float(np.median(np.abs(20.0 * np.log10(np.abs(self.after.response / self.before.response)))))

    @property
    def known_to_db(self) -> float:
        """Half the width of the new response's interval, median over the band."""
        return float(0.5 * np.median(np.ptp(self.after.db, axis=0)))

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "axis": self.axis,
            "flights": list(self.flights),
            "law": self.law,
            "holds_for": "the next flight" if self.next_flight else "these flights",
            "band_hz": list(self.band_hz),
            "f_hz": self.f.tolist(),
            "before": self.before.to_dict(),
            "after": self.after.to_dict(),
            "noise": self.noise.to_dict(),
            "tracking": self.tracking.to_dict(),
            "better": self.better,
            "moved_db": self.moved_db,
            "known_to_db": self.known_to_db,
            "off": self.off,
        }


def forecast(logs: Sequence[Any], axis: str, changes: Mapping[str, str]) -> Forecast:
    """What an axis would do under other settings than those of the last flight.

    `logs`: flights of one vehicle, under any gains.
    `changes`: see `with_settings`.
    Raises UsageError: a setting that the log does not state; settings that change nothing of this loop.
    Raises DataError: see `flysid gains`: the law is not what flew, or the plant is not known.
    """
    return forecast_of(KnownAxis.of(logs, axis), changes)


def forecast_of(known: KnownAxis, changes: Mapping[str, str]) -> Forecast:
    """As `forecast`, of flights that were read."""
    new, conditions = known.law_under(changes)
    old, f = known.last.controller, known.f
    if np.allclose(old.feedback(f), new.feedback(f)) and np.allclose(old.reference(f), new.reference(f)):
        raise UsageError(
            f"{', '.join(changes)}: nothing of the {known.axis} rate loop changes",
            hint="other values, or --axis",
        )
    last = known.last
    at = (known.together.f >= known.band_hz[0]) & (known.together.f <= known.band_hz[1])
    measured = closed_loop(last.loop.mean)[at]
    told = _answer(plant(last.loop.mean)[at], f, old)
    errors = Errors.of(known)
    before, after = (
        _side(known, controller, own.output_limit, errors)
        for controller, own in ((old, last.conditions), (new, conditions))
    )
    return Forecast(
        known.axis,
        tuple(flight.name for flight in known.flights),
        known.next_flight,
        f,
        known.band_hz,
        before,
        after,
        _noise(known, old, new),
        _error_of(before, after),
        float(np.mean((after.errors[1:] < before.errors[1:]) & ~after.lost)),
        float(np.median(np.abs(told / measured - 1.0))),
        old.law,
    )


def _error_of(before: Side, after: Side) -> Figure:
    """The error after over before; none where it is unstable on more plants than an interval leaves out."""
    if after.unstable > INSIDE[0]:
        return Figure(
            None, why=f"{100.0 * after.unstable:.0f} % of the plants that fit make this loop unstable"
        )
    return _figure_of(after.errors[0] / before.errors[0], after.errors[1:] / before.errors[1:])


def _answer(g: ComplexArray, f: FloatArray, controller: Controller) -> ComplexArray:
    """From setpoint to rate."""
    return np.asarray(g * controller.reference(f) / (1.0 + g * controller.feedback(f)))


def _side(known: KnownAxis, controller: Controller, limit: float, errors: Errors) -> Side:
    f, centre, draws = known.f, known.centre, known.draws
    rest = controller.at_rest()
    back, forward = rest.feedback(f), rest.reference(f)
    every = np.array([list_figures(f, g, back, forward) for g in draws])
    one = list_figures(f, centre, back, forward)
    figures = {name: _figure(one[k], every[:, k], f) for k, name in enumerate(NAMES)}
    response, answers = known.answers(controller)
    turn = np.degrees(np.angle(answers / response)) + np.degrees(np.unwrap(np.angle(response)))
    answer, others = _step_answers(known, controller)
    lost = (every[:, 1] <= 0.0) | (every[:, 2] <= 0.0)
    return Side(
        controller.gains,
        figures,
        response,
        np.quantile(20.0 * np.log10(np.abs(answers)), INSIDE, axis=0),
        np.quantile(turn, INSIDE, axis=0),
        _step_figures(answer, others),
        answer[: round(SHOWN_S * STEP_RATE_HZ)],
        _limited(known, controller, limit),
        lost,
        errors.under(controller),
    )


def _figure(value: float, every: FloatArray, f: FloatArray) -> Figure:
    """With the ends of its interval; none where a draw does not reach it inside the band."""
    if not np.isfinite(value) or not np.isfinite(every).all():
        return Figure(None, why=f"not between {f[0]:.1f} and {f[-1]:.0f} Hz, which the sticks excite")
    low, high = np.quantile(every, INSIDE)
    return Figure(float(value), float(min(low, value)), float(max(high, value)))


def _figure_of(value: float, every: FloatArray, why: str = "") -> Figure:
    """With the interval of its draws; none, and why, where one of them is not a number."""
    if why and not (np.isfinite(value) and np.isfinite(every).all()):
        return Figure(None, why=why)
    low, high = np.quantile(every, INSIDE)
    return Figure(float(value), float(min(low, value)), float(max(high, value)))


def _faded(controller: Controller, high: float) -> Controller:
    """With a recorded F term that fades above the band, where it is noise."""
    if controller.recorded_forward is None:
        return controller
    at, values = controller.recorded_forward
    return replace(
        controller, recorded_forward=(at, values * np.minimum(1.0, high / np.maximum(at, 1e-6)) ** 2)
    )


def _step_answers(known: KnownAxis, controller: Controller) -> tuple[FloatArray, FloatArray]:
    """(N,) the answer to a step of the setpoint, 1000 values a second, and (D, N) those of the draws."""
    f = np.asarray(np.fft.rfftfreq(STEP_LENGTH, 1.0 / STEP_RATE_HZ), dtype=np.float64)
    faded = _faded(controller, known.f[-1])
    at = np.maximum(f, 1e-3)
    fitted, draws = known.everywhere(at)
    responses = _answer(np.vstack([fitted, draws]), at, faded)
    responses[:, 0] = 1.0
    answers = np.cumsum(np.fft.irfft(responses, STEP_LENGTH), axis=1)
    return np.asarray(answers[0]), np.asarray(answers[1:])


def step_of(known: KnownAxis, controller: Controller) -> StepFigures:
    """The answer of an axis to a step of the setpoint under a controller."""
    return _step_figures(*_step_answers(known, controller))


def _step_figures(answer: FloatArray, others: FloatArray) -> StepFigures:
    rises, peaks = np.array([_rise_and_peak(own) for own in (answer, *others)]).T
    late = f"not every plant that fits settles at the setpoint, or comes to it within {SHOWN_S:g} s"
    return StepFigures(*(_figure_of(row[0], row[1:], late) for row in (rises, peaks)))


def _rise_and_peak(answer: FloatArray) -> tuple[float, float]:
    """s from a tenth to nine tenths, and how far it goes beyond 1.

    Not a number where it moves before the step, as that of a loop that is not stable does, or never comes up.
    """
    shown = answer[: round(SHOWN_S * STEP_RATE_HZ)]
    early, late = (int(np.argmax(shown >= level)) for level in (0.1, 0.9))
    if late <= early or np.ptp(answer[len(answer) // 2 :]) > LEFT:
        return np.nan, np.nan
    return (late - early) / STEP_RATE_HZ, max(0.0, float(shown.max()) - 1.0)


def _limited(known: KnownAxis, controller: Controller, limit: float) -> float:
    """Share of the last flight at the output's limit: what it was, and what the setpoint changes in it."""
    over, rows = 0, 0
    record, high = known.last.record, known.f[-1]
    flown = known.last.controller
    for piece in record.pieces:
        r, u = piece[0], piece[1]
        f = np.asarray(np.fft.rfftfreq(len(r), 1.0 / record.rate_hz), dtype=np.float64)
        away = np.zeros(len(f), dtype=np.complex128)
        if controller is not flown:
            at = np.maximum(f, 1e-3)
            g = known.turning.response(at, 1.0 / record.rate_hz)
            new, old = (_answer(g, at, _faded(own, high)) / g for own in (controller, flown))
            away = np.where(f <= high, new - old, 0.0)
        changed = u + np.fft.irfft(away * np.fft.rfft(r), len(r))
        over += int((np.abs(changed) >= limit - 1.0).sum())
        rows += len(r)
    return over / max(rows, 1)


def _noise(known: KnownAxis, old: Controller, new: Controller) -> Figure:
    """Root mean square of the output above what the sticks move, new over old, from the flight's own gyro."""
    if HIGHEST * known.last.record.rate_hz <= NOISE_FROM_HZ:
        return Figure(None, why="the log is too slow")
    noise = Noise.of(known)
    found = noise.under(new) / noise.under(old) * noise.others
    return _figure_of(found[0], found[1:])
