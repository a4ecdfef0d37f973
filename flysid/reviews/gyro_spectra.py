"""Spectra of one flight's gyro, with the filters and motors that shape them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from flysid.errors import DataError
from flysid.reviews.filters import gyro_chain
from flysid.reviews.gyro import LoggedGyro, command_of, logged_gyro, motors_hz, sources_of, throttle_of
from flysid.reviews.logged import Column, LoggedFlight
from flysid.spectra.causes import name_causes, sizes_along
from flysid.spectra.chain import Chain
from flysid.spectra.peaks import Peak, peaks_of
from flysid.spectra.spectrum import Windows, windows_of

HARDEST_SHAKE = 20_000.0
"""deg/s2, beyond which no tone is looked for: a racer's raw gyro has 14 deg/s at 63 Hz or, folded, 186 Hz."""
SLOWEST_TONE_HZ = 3.0
"""Below it, no peak is looked for: what moves is the vehicle."""
FAR_MORE = 2.0
"""Times the size of any other motor's: none is named before."""


@dataclass(frozen=True, eq=False)
class Shaking:
    """The spectra of one flight's gyro.

    `flight`, `gyro`: what they are of.
    `windows`: axis -> in the air, of the signal that shows most.
    `chain`: of the filters; None where it is not known.
    `no_chain`: why not.
    """

    flight: LoggedFlight
    gyro: LoggedGyro
    windows: dict[str, Windows]
    chain: Chain | None
    no_chain: str = ""

    @classmethod
    def of(cls, flight: LoggedFlight) -> Shaking:
        """Of a flight."""
        gyro = logged_gyro(flight)
        windows = {}
        for axis, column in gyro.best.items():
            air = column.where(flight.flying(column.time_s))
            try:
                windows[axis] = windows_of(air.time_s, air.values)
            except DataError:
                continue
        try:
            return cls(flight, gyro, windows, gyro_chain(flight, gyro))
        except DataError as error:
            return cls(flight, gyro, windows, None, error.message)

    @cached_property
    def throttle(self) -> Column | None:
        """0 to 1."""
        return throttle_of(self.flight)

    @cached_property
    def peaks(self) -> dict[str, list[Peak]]:
        """Axis -> peaks with their causes, the strongest first."""
        return {
            axis: name_causes(
                windows,
                peaks_of(windows, lowest_hz=SLOWEST_TONE_HZ),
                sources_of(self.flight, axis),
                self.throttle if self.gyro.best is self.gyro.raw else None,
            )
            for axis, windows in self.windows.items()
        }

    @property
    def strongest(self) -> tuple[str, Peak] | None:
        """Axis and peak that carry most power."""
        found = [(axis, peak) for axis, peaks in self.peaks.items() for peak in peaks]
        return max(found, key=lambda pair: pair[1].rms, default=None)

    @cached_property
    def worst_motor(self) -> tuple[int, str, float] | None:
        """A motor that shakes the vehicle far more than the others do, the axis, and the size in deg/s."""
        motors = motors_hz(self.flight)
        if len(motors) < 2:
            return None
        found = []
        for axis, windows in self.windows.items():
            turns = np.stack([motor.held(windows.at_s) for motor in motors.values()])
            sizes = sizes_along(windows, turns)
            order = np.argsort(sizes)
            if np.isfinite(sizes).all() and sizes[order[-1]] > FAR_MORE * sizes[order[-2]]:
                found.append((float(sizes[order[-1]]), list(motors)[order[-1]], axis))
        if not found:
            return None
        size, number, axis = max(found)
        return number, axis, size

    def commanded(self, axis: str, peak: Peak) -> bool:
        """Whether the pilot, or where no stick moved the setpoint, has a peak at the same frequency."""
        command = command_of(self.flight, axis)
        if command is None:
            return False
        air = command.where(self.flight.flying(command.time_s))
        try:
            windows = windows_of(air.time_s, air.values)
        except DataError:
            return False
        own = peaks_of(windows, lowest_hz=SLOWEST_TONE_HZ / 2.0)
        return any(
            low.band[0] <= peak.hz <= low.band[1] or abs(low.hz - peak.hz) < windows.step_hz for low in own
        )

    @property
    def is_raw(self) -> bool:
        """Whether the spectra are of the gyro before its filters, of every other sample at least."""
        best = self.gyro.best is self.gyro.raw and self.gyro.every_sample and bool(self.windows)
        if not best or self.chain is None:
            return False
        rate = min(windows.rate_hz for windows in self.windows.values())
        return rate > 0.4 * self.chain.fastest_hz

    def may_fold(self, peak: Peak) -> bool:
        """Whether the peak may be a faster tone: one that filters pass, and that a vehicle can shake by."""
        faster_hz = peak.folded(8.0 * peak.nyquist_hz)[0]
        shown, folded = (2.0 * np.pi * hz * peak.rms for hz in (peak.hz, faster_hz))
        if self.is_raw or shown <= HARDEST_SHAKE < folded:  # a harder one excludes neither
            return False
        if self.gyro.best is self.gyro.raw or self.chain is None:
            return True
        passed, faster = np.abs(self.chain.response(np.array([peak.hz, faster_hz])))
        return bool(faster > 0.1 * passed)
