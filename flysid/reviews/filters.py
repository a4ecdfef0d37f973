"""The filters of a log's gyro, and the rows on which they can be run again."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.ingest.align.signals import quantum
from flysid.loops.axis_flight import slower
from flysid.loops.betaflight import stated_step_s
from flysid.reviews.gyro import LoggedGyro, motors_hz, throttle_of
from flysid.reviews.logged import Column, LoggedFlight
from flysid.reviews.remedies import remedy
from flysid.spectra.ardupilot import Sources, ardupilot_chain
from flysid.spectra.betaflight import betaflight_chain
from flysid.spectra.chain import Chain
from flysid.spectra.inav import inav_chain
from flysid.spectra.px4 import px4_chain
from flysid.spectra.replay import Replayed, Rows, compare
from flysid.spectra.spectrum import whole_stretches


def gyro_chain(flight: LoggedFlight, gyro: LoggedGyro) -> Chain:
    """The filters that the firmware of a log applies to its gyro.

    Raises DataError: they are not known: another firmware, or the log does not state them.
    """
    if flight.family == "betaflight":
        return betaflight_chain(
            flight.headers, _lateness(flight), throttle_of(flight), list(motors_hz(flight).values())
        )
    if flight.family == "inav":
        return inav_chain(flight.headers, _lateness(flight))
    if flight.family == "px4":
        return px4_chain(flight.parameters, _rate(flight, gyro), list(motors_hz(flight).values()))
    if flight.family == "ardupilot":
        sources = Sources(
            throttle_of(flight),
            _turns(flight, "RPM.rpm1", "RPM.RPM1"),
            _turns(flight, "RPM.rpm2", "RPM.RPM2"),
            flight.quantity("FTN1.PkAvg", unit="Hz", stated="Hz"),
            list(motors_hz(flight).values()),
        )
        return ardupilot_chain(flight.parameters, _rate(flight, gyro), sources)
    raise DataError(
        f"the filters of {flight.info.get('autopilot') or 'this firmware'} are not known here",
        hint="those of ArduPilot, PX4, Betaflight and INAV are; the spectrum itself: flysid spectrum LOG",
    )


def _lateness(flight: LoggedFlight) -> float:
    """Real time of an iteration of a blackbox log's loop over the stated one."""
    loops = flight.quantity("main.loopIteration")
    return slower(loops.time_s, loops.values, stated_step_s(flight.headers)) if loops is not None else 1.0


BOTH = "log both at the gyro's rate"
ARDUPILOT_HZ = 1000.0
"""At which ArduPilot samples a gyro at least: older versions do not log it."""


def _turns(flight: LoggedFlight, *addresses: str) -> Column | None:
    rpm = flight.quantity(*addresses, unit="rpm", stated="rpm")
    return None if rpm is None else Column(rpm.address, "Hz", rpm.time_s, rpm.values / 60.0)


def _rate(flight: LoggedFlight, gyro: LoggedGyro) -> float:
    """At which the filters run: of the raw signal where every sample is logged, else as the log states it.

    Raises DataError: neither is known.
    """
    if gyro.every_sample and gyro.raw:
        return gyro.raw["roll"].rate_hz
    names = [f"{stream}.GHz" for stream in flight.things("IMU")]
    stated = flight.quantity(
        "vehicle_imu_status.gyro_raw_rate_hz", "vehicle_imu_status.gyro_rate_hz", *names, unit="Hz"
    )
    if stated is not None and np.median(stated.values) > 0.0:
        return float(np.median(stated.values))
    if flight.family == "ardupilot":
        return ARDUPILOT_HZ
    raise DataError("the log does not state the rate of the gyro", hint="log vehicle_imu_status or IMU")


@dataclass(frozen=True, eq=False)
class Replayable:
    """Rows of every axis, and their rate."""

    rows: dict[str, list[Rows]]
    rate_hz: float
    step: float

    def compare(self, chain: Chain, axis: str) -> Replayed:
        """A chain against what the firmware made of the raw signal; see `flysid.spectra.replay.compare`."""
        return compare(chain, self.rows[axis], self.rate_hz, self.step)


def replayable(flight: LoggedFlight, gyro: LoggedGyro) -> Replayable:
    """Raw and filtered gyro side by side, in stretches without a lost row.

    Raises DataError: the log does not hold both, sample by sample.
    """
    if not gyro.raw:
        raise DataError(gyro.missing, hint=gyro.remedy)
    if not gyro.every_sample:
        raise DataError(f"the filters cannot run again on {gyro.note}", hint=remedy(flight, "gyro", BOTH))
    loops = flight.quantity("main.loopIteration")
    stamps = gyro.raw["roll"].time_s
    parts = whole_stretches(stamps, longest_gap=1.5) if loops is None else _counted_stretches(loops)
    rows: dict[str, list[Rows]] = {}
    for axis, raw in gyro.raw.items():
        behind = gyro.filtered.get(axis)
        if behind is None:
            raise DataError(
                "the log does not hold the gyro behind its filters", hint=remedy(flight, "gyro", BOTH)
            )
        beside = _beside(raw, behind)
        rows[axis] = [Rows(raw.time_s[p], raw.values[p], beside[p]) for p in parts]
    step = max(quantum(gyro.raw["roll"].values), quantum(gyro.filtered["roll"].values))
    return Replayable(rows, _row_rate(gyro.raw["roll"].time_s, parts), step)


def _beside(raw: Column, behind: Column) -> FloatArray:
    """(N,) the filtered gyro at the raw samples that it was made of; NaN where it was not logged."""
    place = np.clip(np.searchsorted(raw.time_s, behind.time_s), 1, len(raw) - 1)
    earlier = behind.time_s - raw.time_s[place - 1] < raw.time_s[place] - behind.time_s
    place = place - earlier
    own = np.abs(raw.time_s[place] - behind.time_s) < raw.period_s / 2.0
    found = np.full(len(raw), np.nan)
    found[place[own]] = behind.values[own]
    return found


def _counted_stretches(loops: Column) -> list[slice]:
    """Stretches in which every row is as many iterations behind the last one as most are."""
    steps = np.diff(loops.values)
    cuts = np.flatnonzero(steps != np.median(steps)) + 1
    edges = [0, *cuts.tolist(), len(loops)]
    return [slice(a, b) for a, b in pairwise(edges) if b - a > 1]


def _row_rate(time_s: FloatArray, parts: list[slice]) -> float:
    rows = sum(part.stop - part.start - 1 for part in parts)
    return float(rows / sum(float(time_s[part.stop - 1] - time_s[part.start]) for part in parts))
