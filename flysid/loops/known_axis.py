"""One axis of some flights: the plant that they show, and what else it may be, at any frequency.

Flights differ in their plants (battery, air, throttle). With three flights or more the draws come from those
differences and hold for one more flight; with fewer they come from the scatter inside the flights, and hold
for these. Where the sticks move nothing, the plant is gain / (s (lag s + 1)) e^(-delay s), the one that fits
the measured band best; every draw stays as far from it there as it is at the band's end.

A law in small motions leaves out what moves with the flight: D that grows, an integral that relaxes, limits.
The law's miss is the response to the sticks that the last flight shows, over the one that plant and law give.
It enters every response, so that one under the present settings is the measured one. How far it holds under
others is not known: draws have it to the power of 1 and a normal deviate, so that some have none and some
twice as much.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.ndimage import convolve1d

from flysid.dataset import FloatArray
from flysid.loops.betaflight import NO_CONDITIONS, Conditions
from flysid.loops.controller import Controller, refuse_misfit
from flysid.loops.flown_axis import Turning
from flysid.loops.judged import kind_of
from flysid.loops.margins import FEW_POWERS, NEIGHBOURS, least_off, loop_around, smooth, trusted_band
from flysid.loops.new_settings import with_settings
from flysid.loops.prediction import fit_turning, weights
from flysid.loops.stick_response import ComplexArray, Loop, StickRecord, closed_loop, plant

FLIGHTS_FOR_THE_NEXT = 3


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight of the axis, and the law that flew."""

    name: str
    settings: Mapping[str, Any]
    record: StickRecord
    conditions: Conditions
    controller: Controller
    loop: Loop

    @classmethod
    def of(cls, log: Any, axis: str) -> Flown:
        """A flight, checked against its law. Raises DataError: see `flysid gains`."""
        kind = kind_of(log)
        settings = kind.settings(log)
        kind.controller(settings, axis, NO_CONDITIONS)  # what is missing is named before the flight is read
        record, conditions = kind.record(log, axis, settings)
        controller = kind.controller(settings, axis, conditions)
        loop = loop_around([record], controller)
        refuse_misfit(controller, loop, *trusted_band(loop), conditions.checks)
        return cls(log.name, settings, record, conditions, controller, loop)


@dataclass(frozen=True, eq=False)
class KnownAxis:
    """What some flights tell of one axis.

    `log`: the last flight's, whose settings are the present ones.
    `flights`: in their order.
    `together`: all of them.
    `f`, `band_hz`: (F,) Hz, the lines of the band in which the plant is known.
    `centre`, `draws`: (F,) the plant there, and (D, F) what else it may be.
    `turning`: that fits the plant.
    `miss`: (F,) of the law, a factor of the response to the setpoint.
    `missed`: (D, F) what else that may be.
    """

    axis: str
    log: Any
    flights: tuple[Flown, ...]
    together: Loop
    f: FloatArray
    band_hz: tuple[float, float]
    centre: ComplexArray
    draws: ComplexArray
    turning: Turning
    miss: ComplexArray
    missed: ComplexArray

    @classmethod
    def of(cls, logs: Sequence[Any], axis: str) -> KnownAxis:
        """From flights of one vehicle, under any gains.

        Raises DataError: the law is not what flew, or the plant is not known.
        """
        flights = _alike([Flown.of(log, axis) for log in logs])
        loops = [flight.loop for flight in flights]
        together = Loop(loops[0].f, tuple(blocks for loop in loops for blocks in loop.blocks))
        band = trusted_band(together)
        at = (together.f >= band[0]) & (together.f <= band[1])
        if len(loops) < FLIGHTS_FOR_THE_NEXT:
            centre, draws, _ = least_off(together, at)
        else:
            centre, _ = smooth(together, at, FEW_POWERS)
            apart = np.log(np.array([plant(loop.mean)[at] for loop in loops]) / plant(together.mean)[at])
            draws = centre * np.exp(weights(len(loops)) @ apart)
        turning = fit_turning(together, at, 1.0 / flights[-1].record.rate_hz)
        miss, missed = _misses(flights[-1], at, len(draws))
        return cls(
            axis, logs[-1], flights, together, together.f[at], band, centre, draws, turning, miss, missed
        )

    @property
    def last(self) -> Flown:
        """The flight whose settings are the present ones."""
        return self.flights[-1]

    @property
    def next_flight(self) -> bool:
        """Whether the draws hold for one more flight."""
        return len(self.flights) >= FLIGHTS_FOR_THE_NEXT

    def law_under(self, changes: Mapping[str, str]) -> tuple[Controller, Conditions]:
        """The controller under other settings, as the last flight would have moved it.

        Raises UsageError: a setting that the log does not state.
        """
        kind, last = kind_of(self.log), self.last
        other = with_settings(last.settings, changes)
        conditions = last.conditions
        if kind.under is not None:
            conditions = kind.under(self.log, self.axis, last.settings, other, conditions, self.turning)
        return kind.controller(other, self.axis, conditions), conditions

    def answers(self, controller: Controller) -> tuple[ComplexArray, ComplexArray]:
        """(F,) from setpoint to rate under a controller, and (D, F) what else it may be."""
        back, forward = controller.feedback(self.f), controller.reference(self.f)
        found = (g * forward / (1.0 + g * back) for g in (self.centre, self.draws))
        centre, draws = (own * factor for own, factor in zip(found, (self.miss, self.missed), strict=True))
        return np.asarray(centre), np.asarray(draws)

    def misses_at(self, f: FloatArray) -> ComplexArray:
        """(1 + D, F) the law's miss and what else it may be; it fades below the band, where loops follow."""
        at = np.append(0.0, self.f)
        rows = np.log(np.vstack([self.miss, self.missed]))
        padded = np.hstack([np.zeros((len(rows), 1)), rows])
        return np.asarray(np.exp([np.interp(f, at, x.real) + 1j * np.interp(f, at, x.imag) for x in padded]))

    def everywhere(self, f: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """(F,) the plant that fits and (D, F) what else it may be, at any frequencies above 0, Hz."""
        fitted = self.turning.response(f, 1.0 / self.last.record.rate_hz)
        x, at, away = np.log(f), np.log(self.f), np.log(self.draws / self.centre)
        off = np.array([np.interp(x, at, row.real) + 1j * np.interp(x, at, row.imag) for row in away])
        return fitted, np.asarray(fitted * np.exp(off))


def _alike(flights: Sequence[Flown]) -> tuple[Flown, ...]:
    """Flights in windows of one length, the longest that any of them needs."""
    window_s = max(1.0 / flight.loop.f[1] for flight in flights)
    return tuple(
        flight
        if flight.loop.f[1] * window_s < 1.0 + 1e-9
        else replace(flight, loop=Loop.of([flight.record], window_s))
        for flight in flights
    )


def _misses(flight: Flown, at: npt.NDArray[np.bool_], count: int) -> tuple[ComplexArray, ComplexArray]:
    """(F,) the measured response over that of plant and law, and (count, F) what else it may be."""
    f, law = flight.loop.f[at], flight.controller
    g = plant(flight.loop.mean)[at]
    measured, scattered = (closed_loop(own)[..., at] for own in (flight.loop.mean, flight.loop.draws))
    miss = _even(np.log(measured * (1.0 + g * law.feedback(f)) / (g * law.reference(f))))
    away = _even(np.log(scattered / measured))
    holds = 1.0 + np.random.default_rng(0).standard_normal((count, 1))
    return np.exp(miss), np.exp(holds * miss + away[np.arange(count) % len(away)])


def _even(logarithms: ComplexArray) -> ComplexArray:
    """(..., F) lines with their neighbours: one alone is as ragged as its windows are few."""
    weight = np.hanning(NEIGHBOURS + 2)[1:-1]
    turned = np.unwrap(logarithms.imag, axis=-1)
    size, turn = (
        convolve1d(part, weight / weight.sum(), axis=-1, mode="nearest") for part in (logarithms.real, turned)
    )
    return np.asarray(size + 1j * turn)
