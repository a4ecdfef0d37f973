"""A rate loop under other settings, beside what it is: margins, response, step, noise, saturation.

The plant is measured in flight (`stick_response`); both controllers are the firmware's law. Flights differ in
their plants (battery, air, throttle). With three flights or more the intervals come from those differences
and hold for one more flight; with fewer they come from the scatter inside the flights, and hold for these.

Between frequencies that the sticks move, and above them, the step and the limits go by the plant
gain / (s (lag s + 1)) e^(-delay s) that fits the measured one best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.loops.betaflight import NO_CONDITIONS, Conditions
from flysid.loops.controller import Controller, refuse_misfit
from flysid.loops.flown_axis import Turning
from flysid.loops.judged import kind_of
from flysid.loops.margins import Figure, least_off, list_figures, smooth, trusted_band
from flysid.loops.new_settings import with_settings
from flysid.loops.prediction import FEW_POWERS, fit_turning, weights
from flysid.loops.stick_response import ComplexArray, Loop, StickRecord, closed_loop, plant

FLIGHTS_FOR_THE_NEXT = 3
NAMES = ("crossover_hz", "phase_deg", "gain_db", "delay_ms", "ms", "bandwidth_hz", "noise")
INSIDE = (0.025, 0.975)
STEP_RATE_HZ, STEP_LENGTH = 1000.0, 4096
SHOWN_S = 1.0
NOISE_FROM_HZ = 30.0


@dataclass(frozen=True)
class StepFigures:
    """Of the answer to a step of the setpoint: s from a tenth to nine tenths, and how far it overshoots."""

    rise_s: float
    overshoot: float


@dataclass(frozen=True, eq=False)
class Side:
    """A loop under one set of gains.

    Attributes
    ----------
    gains : as the firmware names them.
    figures : by name, as of `Margins`.
    response : (F,) from setpoint to rate, and its ends in dB and deg, (2, F) each.
    step : figures of the step; (N,) the answer itself, 1000 values a second.
    limited : share of the flight at the output's limit.
    unstable : share of the drawn plants with which the loop is not stable.
    """

    gains: Mapping[str, float]
    figures: Mapping[str, Figure]
    response: ComplexArray
    db: FloatArray
    deg: FloatArray
    step: StepFigures
    answer: FloatArray
    limited: float
    unstable: float

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        figures = {
            name: None if own.value is None else {"value": own.value, "low": own.low, "high": own.high}
            for name, own in self.figures.items()
        }
        response = {
            "db": (20.0 * np.log10(np.abs(self.response))).tolist(),
            "db_interval": self.db.tolist(),
            "deg": np.degrees(np.unwrap(np.angle(self.response))).tolist(),
            "deg_interval": self.deg.tolist(),
        }
        step = {"rise_s": self.step.rise_s, "overshoot": self.step.overshoot, "answer": self.answer.tolist()}
        rest = {"limited": self.limited, "unstable": self.unstable}
        return {"gains": dict(self.gains), "figures": figures, "response": response, "step": step} | rest


@dataclass(frozen=True, eq=False)
class Forecast:
    """One axis under other settings.

    Attributes
    ----------
    flights : whose plants it goes by.
    next_flight : whether the intervals hold for one more flight.
    f, band_hz : (F,) Hz of the responses, inside the band in which the plant is known.
    before, after : under the flown settings, and the new ones.
    noise : of the output above what the sticks move, after over before; None where the log holds none.
    off : median error of the response under the flown settings against the measured one.
    law : firmware and version.
    """

    axis: str
    flights: tuple[str, ...]
    next_flight: bool
    f: FloatArray
    band_hz: tuple[float, float]
    before: Side
    after: Side
    noise: float | None
    off: float
    law: str

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
            "noise": self.noise,
            "off": self.off,
        }


@dataclass(frozen=True, eq=False)
class _Flown:
    """A flight of the axis, and the law that flew."""

    name: str
    settings: Mapping[str, Any]
    record: StickRecord
    conditions: Conditions
    controller: Controller
    loop: Loop


def forecast(logs: Sequence[Any], axis: str, changes: Mapping[str, str]) -> Forecast:
    """What an axis would do under other settings than those of the last flight.

    Parameters
    ----------
    logs : flights of one vehicle, under any gains.
    changes : see `with_settings`.

    Raises
    ------
    UsageError : a setting that the log does not state; settings that change nothing of this loop.
    DataError : see `flysid gains`: the law is not what flew, or the plant is not known.
    """
    flights = [_read(log, axis) for log in logs]
    last = flights[-1]
    kind = kind_of(logs[-1])
    other = with_settings(last.settings, changes)
    _, conditions = kind.record(logs[-1], axis, other)
    new = kind.controller(other, axis, _scaled(conditions, last.conditions))
    old = last.controller
    f, centre, draws, band = _plants([flight.loop for flight in flights])
    if np.allclose(old.feedback(f), new.feedback(f)) and np.allclose(old.reference(f), new.reference(f)):
        raise UsageError(
            f"{', '.join(changes)}: nothing of the {axis} rate loop changes", hint="other values, or --axis"
        )
    rate_hz = last.record.rate_hz
    together = Loop(flights[0].loop.f, tuple(b for flight in flights for b in flight.loop.blocks))
    at = (together.f >= band[0]) & (together.f <= band[1])
    turning = fit_turning(together, at, 1.0 / rate_hz)
    before, after = (
        _side(f, centre, draws, controller, turning, last.record, own.output_limit, old)
        for controller, own in ((old, last.conditions), (new, conditions))
    )
    measured = closed_loop(last.loop.mean)[at]
    told = _answer(plant(last.loop.mean)[at], f, old)
    return Forecast(
        axis,
        tuple(flight.name for flight in flights),
        len(flights) >= FLIGHTS_FOR_THE_NEXT,
        f,
        band,
        before,
        after,
        _noise(last.loop, turning, old, new, 1.0 / rate_hz),
        float(np.median(np.abs(told / measured - 1.0))),
        old.law,
    )


def _read(log: Any, axis: str) -> _Flown:
    """A flight, checked against its law."""
    kind = kind_of(log)
    settings = kind.settings(log)
    kind.controller(settings, axis, NO_CONDITIONS)  # what is missing is named before the flight is read
    record, conditions = kind.record(log, axis, settings)
    controller = kind.controller(settings, axis, conditions)
    loop = Loop.of([record])
    refuse_misfit(controller, loop, *trusted_band(loop), conditions.checks)
    return _Flown(log.name, settings, record, conditions, controller, loop)


def _scaled(new: Conditions, old: Conditions) -> Conditions:
    """Conditions of a new law whose recorded F term is that of the old gain."""
    if new.forward is None or not old.forward_gain:
        return new
    at, values = new.forward
    return replace(new, forward=(at, values * (new.forward_gain / old.forward_gain)))


def _plants(
    loops: Sequence[Loop],
) -> tuple[FloatArray, ComplexArray, ComplexArray, tuple[float, float]]:
    """Lines of the band, the plant of all flights, and (D, F) what another flight's may be."""
    together = Loop(loops[0].f, tuple(blocks for loop in loops for blocks in loop.blocks))
    low, high = trusted_band(together)
    at = (together.f >= low) & (together.f <= high)
    f = together.f[at]
    if len(loops) < FLIGHTS_FOR_THE_NEXT:
        centre, draws, _ = least_off(together, at)
        return f, centre, draws, (low, high)
    centre, _ = smooth(together, at, FEW_POWERS)
    apart = np.log(np.array([plant(loop.mean)[at] for loop in loops]) / plant(together.mean)[at])
    return f, centre, centre * np.exp(weights(len(loops)) @ apart), (low, high)


def _answer(g: ComplexArray, f: FloatArray, controller: Controller) -> ComplexArray:
    """From setpoint to rate."""
    return np.asarray(g * controller.reference(f) / (1.0 + g * controller.feedback(f)))


def _side(
    f: FloatArray,
    centre: ComplexArray,
    draws: ComplexArray,
    controller: Controller,
    turning: Turning,
    record: StickRecord,
    limit: float,
    flown: Controller,
) -> Side:
    rest = controller.at_rest()
    back, forward = rest.feedback(f), rest.reference(f)
    every = np.array([list_figures(f, g, back, forward) for g in draws])
    one = list_figures(f, centre, back, forward)
    figures = {name: _figure(one[k], every[:, k], f) for k, name in enumerate(NAMES)}
    answers = _answer(draws, f, controller)
    response = _answer(centre, f, controller)
    turn = np.degrees(np.angle(answers / response)) + np.degrees(np.unwrap(np.angle(response)))
    answer = _step_answer(turning, controller, f[-1])
    lost = (every[:, 1] <= 0.0) | (every[:, 2] <= 0.0)
    return Side(
        controller.gains,
        figures,
        response,
        np.quantile(20.0 * np.log10(np.abs(answers)), INSIDE, axis=0),
        np.quantile(turn, INSIDE, axis=0),
        _step_figures(answer),
        answer[: round(SHOWN_S * STEP_RATE_HZ)],
        _limited(record, turning, flown, controller, limit, f[-1]),
        float(np.mean(lost)),
    )


def _figure(value: float, every: FloatArray, f: FloatArray) -> Figure:
    """With the ends of its interval; none where a draw does not reach it inside the band."""
    if not np.isfinite(value) or not np.isfinite(every).all():
        return Figure(None, why=f"not between {f[0]:.1f} and {f[-1]:.0f} Hz, which the sticks excite")
    low, high = np.quantile(every, INSIDE)
    return Figure(float(value), float(min(low, value)), float(max(high, value)))


def _closed(turning: Turning, controller: Controller, f: FloatArray, high: float) -> ComplexArray:
    """From setpoint to rate at any frequencies; a recorded F term fades above the band, where it is noise."""
    faded = controller
    if controller.recorded_forward is not None:
        at, values = controller.recorded_forward
        faded = replace(
            controller, recorded_forward=(at, values * np.minimum(1.0, high / np.maximum(at, 1e-6)) ** 2)
        )
    g = turning.response(np.maximum(f, 1e-3), 1.0 / STEP_RATE_HZ)
    return _answer(g, np.maximum(f, 1e-3), faded)


def _step_answer(turning: Turning, controller: Controller, high: float) -> FloatArray:
    """(N,) the answer to a step of the setpoint, 1000 values a second."""
    f = np.asarray(np.fft.rfftfreq(STEP_LENGTH, 1.0 / STEP_RATE_HZ), dtype=np.float64)
    response = _closed(turning, controller, f, high)
    response[0] = 1.0
    return np.asarray(np.cumsum(np.fft.irfft(response, STEP_LENGTH)))


def _step_figures(answer: FloatArray) -> StepFigures:
    shown = answer[: round(SHOWN_S * STEP_RATE_HZ)]
    early, late = (int(np.argmax(shown >= level)) for level in (0.1, 0.9))
    return StepFigures((late - early) / STEP_RATE_HZ, max(0.0, float(shown.max()) - 1.0))


def _limited(
    record: StickRecord,
    turning: Turning,
    flown: Controller,
    controller: Controller,
    limit: float,
    high: float,
) -> float:
    """Share of a flight at the output's limit: what it was, and what the setpoint changes in it."""
    over, rows = 0, 0
    for piece in record.pieces:
        r, u = piece[0], piece[1]
        f = np.asarray(np.fft.rfftfreq(len(r), 1.0 / record.rate_hz), dtype=np.float64)
        away = np.zeros(len(f), dtype=np.complex128)
        if controller is not flown:
            g = turning.response(np.maximum(f, 1e-3), 1.0 / record.rate_hz)
            new, old = (_closed(turning, own, f, high) / g for own in (controller, flown))
            away = np.where(f <= high, new - old, 0.0)
        changed = u + np.fft.irfft(away * np.fft.rfft(r), len(r))
        over += int((np.abs(changed) >= limit - 1.0).sum())
        rows += len(r)
    return over / max(rows, 1)


def _noise(loop: Loop, turning: Turning, old: Controller, new: Controller, step_s: float) -> float | None:
    """Root mean square of the output above what the sticks move, new over old, from the flight's own gyro.

    None of a log that is too slow to hold anything there.
    """
    at = (loop.f >= NOISE_FROM_HZ) & (loop.f < 0.4 / step_s)
    if not at.any():
        return None
    f = loop.f[at]
    power = loop.mean[2, 2][at].real / np.abs(1.0 - np.exp(-2j * np.pi * f * step_s)) ** 2
    g = turning.response(f, step_s)
    before, after = (np.abs(own.feedback(f)) ** 2 for own in (old, new))
    louder = np.abs((1.0 + g * old.feedback(f)) / (1.0 + g * new.feedback(f))) ** 2
    return float(np.sqrt((after * louder * power).sum() / (before * power).sum()))
