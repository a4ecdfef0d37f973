"""A log looked over without keeping it: rates, losses, whether anything moved, and what to log next time.

Parts of streams are counted and dropped, so that a log of any size is surveyed in bounded memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa

from flysid.errors import FlysidError
from flysid.flight import BOOT, TIME, ClockMap, Damage, Source, field_scale, field_unit, message_of, stem_of
from flysid.flightwriter import float_values, int_values
from flysid.ingest.align.resample import Span
from flysid.ingest.excitation.enough import FLY_MORE, MIN_DURATION_S, least_hz, too_short_alone
from flysid.ingest.formats.base import Limits, StreamPart
from flysid.ingest.formats.opening import open_log
from flysid.ingest.formats.registry import format_of
from flysid.ingest.lake.flown import Flown, Kept, changes, flown, is_measured, widen, within
from flysid.parts import exhaust

ROLES: Mapping[str, tuple[str, ...]] = {
    "attitude": (
        "ATTITUDE",
        "ATT",
        "vehicle_attitude",
        "navdata",
        "demo",
        "imu",
        "odom",
        "odometry",
        "state",
    ),
    "command": (
        "ATTITUDE_TARGET",
        "NAV_CONTROLLER_OUTPUT",
        "RATE",
        "vehicle_attitude_setpoint",
        "references",
        "cmd_vel",
        "command",
    ),
    "velocity": (
        "LOCAL_POSITION_NED",
        "GLOBAL_POSITION_INT",
        "XKF1",
        "NKF1",
        "EKF1",
        "vehicle_local_position",
        "navdata",
        "demo",
        "odom",
        "odometry",
        "state",
    ),
    "rates": ("main", "RATE", "vehicle_angular_velocity"),
}
ANGLES = {"r": ("roll", "Roll", "rotX"), "p": ("pitch", "Pitch", "rotY"), "y": ("yaw", "Yaw", "rotZ")}
RADIANS = {"rad": 1.0, "deg": np.pi / 180, "degheading": np.pi / 180}
MOVED_RAD = np.radians(2.0)
SHARE_LOGGED = 0.9
"""Of the flight: a stream that is there for less of it is told to be."""

RECORD_ANYTHING = "the log ends where its records would begin: copy it again, or fly with logging on"
ADVICE = {
    "blackbox": "log every fourth loop or more: blackbox_sample_rate, before Betaflight 4.3 blackbox_p_ratio",
    "dataflash": "set LOG_BITMASK bit 0 (fast attitude); LOG_FILE_RATEMAX 0",
    "dataflash_text": "set LOG_BITMASK bit 0 (fast attitude)",
    "tlog": "use the vehicle's own .bin log, or raise SR0_EXTRA1 and SR0_POSITION",
    "ulog": "set SDLOG_PROFILE bits 0 and 2 (default and high rate)",
    "navdata": "set general:navdata_demo FALSE and general:navdata_options to all",
}


@dataclass
class StreamCount:
    """What is counted of one stream: rows, their span per boot, and the spread of angles."""

    rows: int = 0
    spans: dict[int, tuple[int, int, int]] = field(default_factory=dict)
    angles: dict[str, tuple[int, float, float]] = field(
        default_factory=dict
    )  # axis -> n, sum, sum of squares

    @property
    def rate_hz(self) -> float:
        """Mean rate inside boots; 0 where time does not advance."""
        seconds = sum(last - first for _, first, last in self.spans.values()) * 1e-9
        return sum(n - 1 for n, _, _ in self.spans.values()) / seconds if seconds > 0 else 0.0

    def spread_rad(self, axis: str) -> float:
        """Standard deviation of an angle."""
        count, total, squares = self.angles.get(axis, (0, 0.0, 0.0))
        return float(np.sqrt(max(0.0, squares / count - (total / count) ** 2))) if count else 0.0


@dataclass(frozen=True)
class Survey:
    """What `flysid doctor` says about a log.

    `flown`: when the vehicle was in the air, as far as the log tells.
    """

    source: Source
    streams: Mapping[str, StreamCount]
    damage: Damage
    clocks: tuple[ClockMap, ...]
    info: Mapping[str, str]
    flown: Flown = Flown()  # noqa: RUF009 - frozen

    @property
    def usable_s(self) -> float:
        """Vehicle time that shipped recipes can use: in the air; all of it where that is unknown."""
        seconds = self.flown.seconds
        return self.duration_s if seconds is None else seconds

    def usable_of(self, stream: str) -> float:
        """The part of `usable_s` from a stream's first row to its last: a log may cease to hold it."""
        logged = {boot: (first, last) for boot, (_, first, last) in self.streams[stream].spans.items()}
        spans = self.flown.spans
        if spans is None:
            return 1e-9 * sum(last - first for first, last in logged.values())
        both = (span for boot, limits in logged.items() for span in within(spans.get(boot, ()), limits))
        return 1e-9 * sum(b - a for a, b in both)

    @property
    def duration_s(self) -> float:
        """Vehicle time, summed over boots."""
        return sum(c.last_ns - c.first_ns for c in self.clocks) * 1e-9

    def role(self, role: str) -> tuple[str, float]:
        """(stream, rate) of the first stream that plays a role; ("", 0) where none does."""
        by_message = {stem_of(message_of(key)).partition("#")[0]: key for key in reversed(list(self.streams))}
        for name in ROLES[role]:
            if name in by_message:
                return by_message[name], self.streams[by_message[name]].rate_hz
        return "", 0.0

    def excited(self) -> str:
        """The axes that moved, of "r p y"; "-" where none did, "?" where angles are not logged as such."""
        stream, _ = self.role("attitude")
        if not stream or not self.streams[stream].angles:
            return "?"
        count = self.streams[stream]
        return " ".join(axis for axis in ANGLES if count.spread_rad(axis) > MOVED_RAD) or "-"


def survey(path: Path, limits: Limits | None = None) -> Survey:
    """Look a log over. Raises FormatError where nothing can be read."""
    limits = limits or Limits()
    with open_log(path, limits) as log:
        fmt = format_of(log, limits)
        streams: dict[str, StreamCount] = {}
        kept: dict[str, list[pa.Table]] = {}

        def look_at(part: StreamPart) -> None:
            _count(streams.setdefault(part.stream, StreamCount()), part.table)
            found = changes(part.stream, part.table)
            if found is not None:
                kept.setdefault(part.stream, []).append(found)

        summary = exhaust(log.read(fmt, limits), look_at)
        source = log.source(fmt)
    streams = {summary.renamed.get(key, key): count for key, count in streams.items()}
    rows = {key: count.rows for key, count in streams.items()}
    tables = {key: pa.concat_tables(parts, promote_options="default") for key, parts in kept.items()}
    measured: dict[int, Span] = {}
    for key, count in streams.items():
        for boot, (_, first, last) in count.spans.items() if is_measured(key) and count.rows > 1 else ():
            widen(measured, boot, (first, last))
    found = flown(Kept(source.name, rows, summary.info, tables), measured)
    ordered = dict(sorted(streams.items()))
    return Survey(source, ordered, summary.damage, summary.clocks, summary.info, found)


def survey_or_reason(path: Path, limits: Limits | None = None) -> Survey | str:
    """`survey`, or why it cannot be had: a task for a worker process."""
    try:
        return survey(path, limits)
    except FlysidError as error:
        return error.advice
    except MemoryError:
        return "not enough memory"


def _count(count: StreamCount, table: pa.Table, *, senseless_rad: float = 1e6) -> None:
    """`senseless_rad`: no heading unwraps to this; NaN and infinity are no angles either."""
    if not table.num_rows:
        return
    count.rows += table.num_rows
    times = int_values(table[TIME])
    boots = int_values(table[BOOT])
    for boot in np.unique(boots).tolist():
        inside = times[boots == boot]
        n, first, last = count.spans.get(boot, (0, int(inside.min()), int(inside.max())))
        count.spans[boot] = (n + len(inside), min(first, int(inside.min())), max(last, int(inside.max())))
    for axis, names in ANGLES.items():
        name = next((n for n in names if n in table.column_names), None)
        if name is None or not pa.types.is_primitive(table.schema.field(name).type):
            continue
        column = table.schema.field(name)
        factor = field_scale(column) * RADIANS.get(field_unit(column) or _unit_of(column), np.pi / 180)
        angles = float_values(table[name]) * factor
        values = np.unwrap(angles[np.abs(angles) < senseless_rad])
        n, total, squares = count.angles.get(axis, (0, 0.0, 0.0))
        count.angles[axis] = (
            n + len(values),
            total + float(values.sum()),
            squares + float((values**2).sum()),
        )


def _unit_of(column: pa.Field) -> str:
    """ArduPilot logs without units hold degrees; MAVLink and ROS hold radians."""
    return "deg" if column.name[0].isupper() or column.name.startswith("rot") else "rad"


def verdict(found: Survey) -> tuple[str, str]:
    """(verdict, advice), the worst first: a verdict is two or three words, then what it rests on."""
    advice = ADVICE.get(found.source.format, "log attitude, its setpoint and velocity at 20 Hz or more")
    share = found.damage.bytes_skipped / max(1, found.source.size_bytes)
    attitude, rate = found.role("attitude")
    velocity, velocity_rate = found.role("velocity")
    rates, rates_hz = found.role("rates")
    if share > 0.05:
        return f"damaged: {100.0 * share:.0f} % of the bytes lost", "copy it from the vehicle again"
    if found.source.format in ("csv", "parquet"):
        return (
            "a table: 'flysid show' lists its columns",
            "name two of its columns to 'flysid fit': --from, --to",
        )
    nothing = not attitude and not velocity and not rates
    if nothing and not round(found.duration_s, 3):
        return "empty: no record behind the definitions", RECORD_ANYTHING
    if nothing:
        return "unusable: no attitude and no velocity", advice
    if found.duration_s < MIN_DURATION_S:
        return f"too short: {found.duration_s:.0f} s", FLY_MORE
    if found.flown.never:
        return f"excluded: {found.flown.never[0]}", "fly, or remove the condition from a recipe of your own"
    if found.usable_s < MIN_DURATION_S and found.flown.seconds is not None:
        return f"too short: flown for {found.usable_s:.0f} s", FLY_MORE
    kind = found.source.format
    if not attitude and not velocity and rates_hz < least_hz("rates", kind):
        return f"too slow: body rates at {rates_hz:.3g} Hz", advice
    usable_s = found.usable_of(attitude or velocity or rates)
    name = "attitude " if attitude else "velocity " if velocity else ""
    whole = "logged" if found.flown.seconds is None else "flown"
    logged = f"{name}logged for {usable_s:.0f} of {found.usable_s:.0f} s {whole}"
    if usable_s < MIN_DURATION_S:
        return f"too short: {logged}", FLY_MORE
    short = too_short_alone(usable_s)
    if usable_s < SHARE_LOGGED * found.usable_s and short:
        short = f"{logged}; {short}"
    if not attitude and not velocity:
        return "ok: body rates only", short
    if attitude and rate < least_hz("attitude", kind):
        usable = velocity_rate >= least_hz("velocity", kind)
        said = "velocity only" if usable else "too slow"
        return f"{said}: attitude at {rate:.2g} Hz", advice
    if found.excited() == "-":
        return "nothing moved", "fly manoeuvres: doublets or sweeps on the axis of interest"
    return "ok", short
