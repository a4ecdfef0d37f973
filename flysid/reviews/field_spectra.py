"""Spectra of any fields of a log, with their peaks: what `flysid spectrum` shows."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from flysid.errors import DataError, UsageError
from flysid.ingest.lake.clocked import MOST
from flysid.reviews.follow import TURN_DEG
from flysid.reviews.gyro import AXES, UNIT, logged_gyro, motors_hz, sources_of, throttle_of
from flysid.reviews.gyro_spectra import HARDEST_SHAKE
from flysid.reviews.logged import Column, LoggedFlight
from flysid.showing import first_of, one_of, significant
from flysid.spectra.causes import name_causes
from flysid.spectra.peaks import Peak, peaks_of
from flysid.spectra.spectrum import Windows, windows_of

OVER = ("time", "throttle", "rpm")


@dataclass(frozen=True, eq=False)
class FieldSpectrum:
    """The spectrum of one field.

    `name`: "roll", or the field as it was named.
    `column`: that it is of.
    `windows`, `peaks`: the strongest peak first.
    """

    name: str
    column: Column
    windows: Windows
    peaks: tuple[Peak, ...]

    def lines(self) -> list[str]:
        """For people."""
        w = self.windows
        unit = f" {self.column.unit}" if self.column.unit else ""
        source = "" if self.name == self.column.address else f" ({self.column.address})"
        head = (
            f"{self.name}{source}: RMS {significant(w.rms())}{unit}, {len(w.at_s):,} windows at "
            f"{significant(w.rate_hz)} Hz (tones above {significant(w.nyquist_hz)} Hz fold)"
        )
        return [head, *(f"  {self._peak_line(peak, unit)}" for peak in self.peaks)] + (
            [] if self.peaks else ["  no peak above the noise"]
        )

    def _peak_line(self, peak: Peak, unit: str) -> str:
        low, high = (significant(edge, 4) for edge in peak.interval)
        hardest = HARDEST_SHAKE if self.column.unit == UNIT else np.inf
        folded = [hz for hz in peak.folded(4.0 * peak.nyquist_hz) if 2.0 * np.pi * hz * peak.rms < hardest]
        others = f"; or {first_of([f'{hz:.0f}' for hz in folded], 3)} Hz, folded" if folded else ""
        return (
            f"{significant(peak.hz, 4)} Hz [{low}, {high}], {peak.height_db:.0f} dB over the floor, "
            f"RMS {significant(peak.rms)}{unit}"
            + (f": {peak.cause}" if peak.cause else others)
            + (f" from {significant(peak.true_hz)} Hz" if peak.true_hz is not None else "")
        )

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "name": self.name,
            "field": self.column.address,
            "unit": self.column.unit,
            "rate_hz": self.windows.rate_hz,
            "nyquist_hz": self.windows.nyquist_hz,
            "windows": len(self.windows.at_s),
            "rms": self.windows.rms(),
            "peaks": [peak.to_dict() for peak in self.peaks],
            "hz": self.windows.hz.tolist(),
            "density": self.windows.mean.tolist(),
        }


def field_spectra(
    flight: LoggedFlight,
    fields: Sequence[str] = (),
    *,
    window_s: float = 1.0,
    lowest_hz: float = 3.0,
    on_ground: bool = False,
) -> list[FieldSpectrum]:
    """Spectra of fields, or of the gyro.

    Parameters
    ----------
    fields : `STREAM.FIELD` each; none: the gyro, before its filters where the log has it.
    window_s : length of a window.
    lowest_hz : peaks below it are the vehicle's motion.
    on_ground : the whole log, not only the time in the air.

    Raises
    ------
    UsageError : a field is not there.
    DataError : the log holds no gyro; a field has too few samples in a row.

    Examples
    --------
    >>> from flysid.ingest.align.signals import FlightLog
    >>> flight = LoggedFlight(FlightLog(flysid.read("sample_logs/01-multisine-seed1.tlog")))
    >>> (found,) = field_spectra(flight, ["ATTITUDE.rollspeed"])
    >>> round(found.windows.rate_hz)
    50
    """
    behind = {column.address for column in logged_gyro(flight).filtered.values()}
    throttle = throttle_of(flight)
    found = []
    for name, column in _columns(flight, fields).items():
        kept = column if on_ground else column.where(flight.flying(column.time_s))
        try:
            windows = windows_of(kept.time_s, kept.values, window_s=window_s)
        except DataError as error:
            raise DataError(
                f"{column.address}: {error.message}", hint=error.hint, path=flight.name
            ) from error
        sources = sources_of(flight, name if name in AXES else AXES[0])
        own = throttle if column.address not in behind else None  # a filter's edge does not move either
        peaks = name_causes(windows, peaks_of(windows, lowest_hz=lowest_hz), sources, own)
        found.append(FieldSpectrum(name, column, windows, tuple(peaks)))
    return found


def _columns(flight: LoggedFlight, fields: Sequence[str]) -> dict[str, Column]:
    if not fields:
        gyro = logged_gyro(flight)
        if not gyro.best:
            raise DataError(
                "the log holds no gyro that is known here",
                path=flight.name,
                hint="name a field: flysid spectrum LOG STREAM.FIELD; 'flysid show LOG --fields' lists them",
            )
        return dict(gyro.best)
    found = {}
    for name in fields:
        column = _named(flight, name)
        if column is None:
            raise UsageError(
                f"{name} is not in the log, or holds no number",
                path=flight.name,
                hint=_what_there_is(flight, name),
            )
        found[name] = column
    return found


def _what_there_is(flight: LoggedFlight, name: str) -> str:
    """Fields of the stream that is meant, or streams."""
    stream, _, field = name.rpartition(".")
    things = flight.things(stream)
    known = list(flight.log.columns(things[0])) if things else sorted(flight.log.rows)
    near = difflib.get_close_matches(field if things else stream, known, n=1, cutoff=0.5)
    meant = f"did you mean {near[0]!r}? " if near else ""
    return f"{meant}it has {first_of(known, 8)}; 'flysid show LOG --fields' lists all"


def _named(flight: LoggedFlight, name: str) -> Column | None:
    """A field in deg/s where it is a rate, else in the first unit of its kind; angles go on beyond a turn."""
    if "." not in name:
        return None
    for unit in (UNIT, *MOST):
        column = flight.quantity(name, unit=unit)
        if column is not None and unit == "deg":
            return replace(column, values=np.unwrap(column.values, period=TURN_DEG))
        if column is not None:
            return column
    return None


def quantity_over(flight: LoggedFlight, windows: Windows, over: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(W,) time, throttle or mean turns a minute of the motors, during each window.

    Raises UsageError: it is none of them. Raises DataError: the log does not hold it.
    """
    if over not in OVER:
        raise UsageError(f"nothing is known over {over!r}", hint=one_of(OVER, over))
    if over == "time":
        return windows.at_s
    throttle = throttle_of(flight)
    if over == "throttle" and throttle is not None:
        return throttle.held(windows.at_s)
    motors = motors_hz(flight)
    if over == "rpm" and motors:
        return np.asarray(60.0 * np.mean([motor.held(windows.at_s) for motor in motors.values()], axis=0))
    what = "the motors' RPM" if over == "rpm" else "the throttle"
    raise DataError(f"the log does not hold {what}", path=flight.name, hint="over time: --over time")
