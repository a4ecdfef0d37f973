"""One axis of some flights: the plant that they show, and what else it may be, at any frequency.

Flights differ in their plants (battery, air, throttle). With three flights or more the draws come from those
differences and hold for one more flight; with fewer they come from the scatter inside the flights, and hold
for these. Where the sticks move nothing, the plant is gain / (s (lag s + 1)) e^(-delay s), the one that fits
the measured band best; every draw stays as far from it there as it is at the band's end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.loops.betaflight import NO_CONDITIONS, Conditions
from flysid.loops.controller import Controller, refuse_misfit
from flysid.loops.flown_axis import Turning
from flysid.loops.judged import kind_of
from flysid.loops.margins import least_off, smooth, trusted_band
from flysid.loops.new_settings import with_settings
from flysid.loops.prediction import FEW_POWERS, fit_turning, weights
from flysid.loops.stick_response import ComplexArray, Loop, StickRecord, plant

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
        """A flight, checked against its law.

        Raises
        ------
        DataError : see `flysid gains`.
        """
        kind = kind_of(log)
        settings = kind.settings(log)
        kind.controller(settings, axis, NO_CONDITIONS)  # what is missing is named before the flight is read
        record, conditions = kind.record(log, axis, settings)
        controller = kind.controller(settings, axis, conditions)
        loop = Loop.of([record])
        refuse_misfit(controller, loop, *trusted_band(loop), conditions.checks)
        return cls(log.name, settings, record, conditions, controller, loop)


@dataclass(frozen=True, eq=False)
class KnownAxis:
    """What some flights tell of one axis.

    Attributes
    ----------
    log : the last flight's, whose settings are the present ones.
    flights : in their order.
    together : all of them.
    f, band_hz : (F,) Hz, the lines of the band in which the plant is known.
    centre, draws : (F,) the plant there, and (D, F) what else it may be.
    turning : that fits the plant.
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

    @classmethod
    def of(cls, logs: Sequence[Any], axis: str) -> KnownAxis:
        """From flights of one vehicle, under any gains.

        Raises
        ------
        DataError : the law is not what flew, or the plant is not known.
        """
        flights = tuple(Flown.of(log, axis) for log in logs)
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
        return cls(axis, logs[-1], flights, together, together.f[at], band, centre, draws, turning)

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

        Raises
        ------
        UsageError : a setting that the log does not state.
        """
        kind = kind_of(self.log)
        other = with_settings(self.last.settings, changes)
        _, conditions = kind.record(self.log, self.axis, other)
        return kind.controller(other, self.axis, _scaled(conditions, self.last.conditions)), conditions

    def everywhere(self, f: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """(F,) the plant that fits and (D, F) what else it may be, at any frequencies above 0, Hz."""
        fitted = self.turning.response(f, 1.0 / self.last.record.rate_hz)
        x, at, away = np.log(f), np.log(self.f), np.log(self.draws / self.centre)
        off = np.array([np.interp(x, at, row.real) + 1j * np.interp(x, at, row.imag) for row in away])
        return fitted, np.asarray(fitted * np.exp(off))


def _scaled(new: Conditions, old: Conditions) -> Conditions:
    """Conditions of a new law whose recorded F term is that of the old gain."""
    if new.forward is None or not old.forward_gain:
        return new
    at, values = new.forward
    return replace(new, forward=(at, values * (new.forward_gain / old.forward_gain)))
