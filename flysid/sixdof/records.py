"""What a flight measured: signals of a dataset by name, in one set of axes and units, damage marked.

A dataset of a vehicle has inputs `motor1`, `motor2`, ... and, where it is measured, `voltage` (V); outputs
`gyro_x`, `gyro_y`, `gyro_z` (rad/s) and, where they are measured, `acc_x` ... (m/s^2, specific force), `q_w`,
`q_x`, `q_y`, `q_z` (attitude), `v_x` ... (m/s) and `p_x` ... (m) in world axes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flysid.dataset import Dataset, Segment
from flysid.errors import DataError, UsageError
from flysid.showing import counted
from flysid.sixdof import rotations
from flysid.sixdof.cleaning import (
    BoolArray,
    Damage,
    beyond_full_scale,
    clock_offsets,
    runs,
    straight_lines,
)
from flysid.sixdof.frames import settle
from flysid.sixdof.instruments import check_instruments, check_lift
from flysid.sixdof.record import Record
from flysid.stretch import FloatArray

GROUPS: Mapping[str, tuple[str, ...]] = {
    "gyro": ("gyro_x", "gyro_y", "gyro_z"),
    "force": ("acc_x", "acc_y", "acc_z"),
    "attitude": ("q_w", "q_x", "q_y", "q_z"),
    "velocity": ("v_x", "v_y", "v_z"),
    "position": ("p_x", "p_y", "p_z"),
}
"""Outputs of a dataset by instrument."""
VOLTAGE = "voltage"
FULL_SCALES = (1.0, 100.0, 255.0, 1000.0, 2047.0, 4095.0, 65535.0)
"""What commands are commonly shares of: one, per cent, 8 bits, per mille, DShot's 11 bits, 12 and 16 bits."""
DSHOT = (48.0, 2047.0)
"""Of DShot's 11 bits the values below are orders to the speed controller: no motor turns at them."""
PULSES = (800.0, 2200.0)
"""Commands between these are pulses of 1,000 to 2,000 us."""
TURNING = 0.05
"""Of full scale: a motor above it turns."""
ALOFT_M = 0.3
"""Above the lowest place of a flight: on the ground, the ground carries."""
COVERED = 0.9
"""Share of samples that a full scale covers: what a link loss invents lies beyond."""
LEAST_MOTORS = 2
LEAST_WINDOWS = 3
"""Of comparing clocks: fewer show no wandering."""
VOLTAGE_S = 1.0
"""Voltage is read slowly, and filled in: slower than this it is averaged."""


@dataclass(frozen=True)
class Scale:
    """What commands are shares of: command = (value - zero) / full.

    Attributes
    ----------
    largest : command, where the scale was found by it; None where it is stated.
    """

    zero: float
    full: float
    largest: float | None = field(default=None, compare=False)

    def __str__(self) -> str:
        found = "" if self.largest is None else f", found from commands up to {self.largest:g}"
        if self.zero:
            what = "pulses" if self.zero >= PULSES[0] else "shares"
            full = self.zero + self.full
            return f"motor commands are {what}: {self.zero:g} stops, {full:g} is full scale{found}"
        return f"motor commands are shares of {self.full:g}{found}"


def find_scale(values: FloatArray) -> Scale:
    """The least common full scale that covers nearly all commands, or all where some reach it."""
    turning = values[values > 0.0]
    if not len(turning):
        return Scale(0.0, 1.0)
    most = float(turning.max())
    low, high = np.quantile(turning, [(1.0 - COVERED) ** 2, COVERED])
    if low >= PULSES[0] and high <= PULSES[1]:
        return Scale(1000.0, 1000.0, float(high))
    largest = most if most in FULL_SCALES else float(high)
    full = next((full for full in FULL_SCALES if largest <= full), most)
    zero = DSHOT[0] if full == DSHOT[1] and low >= DSHOT[0] else 0.0
    return Scale(zero, full - zero, largest)


@dataclass(frozen=True, eq=False)
class Flights:
    """All stretches of a dataset.

    Attributes
    ----------
    scale : what commands are shares of.
    damage : a flight each.
    frames : axes that were not forward, left, up, or whose world did not point up, in words.
    """

    records: tuple[Record, ...]
    scale: Scale
    damage: tuple[Damage, ...]
    frames: tuple[str, ...]

    @property
    def names(self) -> list[str]:
        """Of the flights, in order."""
        return list(dict.fromkeys(record.flight for record in self.records))


def flights_of(data: Dataset, scale: Scale | None = None) -> Flights:
    """The stretches of a dataset, in axes forward, left, up, what is damaged marked and counted.

    Raises
    ------
    UsageError : no motors, or no gyro, among the signals.
    DataError : a voltage that is not above zero; nothing flies; instruments in other units; commands
        that lift less the higher they are.
    """
    motors = _motors_of(data)
    columns = {name: _columns_of(data, name) for name in GROUPS}
    if columns["gyro"] is None:
        raise UsageError(
            f"a vehicle needs outputs {', '.join(GROUPS['gyro'])}", hint="rad/s, about forward, left and up"
        )
    volts = next((i for i, s in enumerate(data.inputs) if s.name == VOLTAGE), None)
    found = scale or find_scale(_whole_commands(data, motors, columns["gyro"]))
    raw = [_read(data, segment, motors, volts, columns, found) for segment in data.segments]
    settled, frames = settle(raw)
    frames = (*frames, *check_instruments(settled))
    damage = tuple(_damage([r for r in settled if r.flight == flight]) for flight in data.flights)
    records = tuple(_aloft(settled))
    if not any(record.stretches for record in records):
        higher = f", {ALOFT_M:g} m above the lowest place" if columns["position"] is not None else ""
        raise DataError(
            f"nothing flies: in {counted(len(data.flights), 'flight')} there is no whole second with all "
            f"motors turning{higher}",
            hint=f"a flight in the air; {found}: if not, state full scale (--zero, --full-scale)",
        )
    check_lift(records)
    return Flights(records, found, damage, frames)


def _motors_of(data: Dataset) -> list[int]:
    """Columns of the motors' commands; UsageError where there are none."""
    found = [i for i, signal in enumerate(data.inputs) if signal.name.startswith("motor")]
    if len(found) < LEAST_MOTORS:
        raise UsageError(
            f"a vehicle needs inputs motor1, motor2, ...; these are {', '.join(s.name for s in data.inputs)}",
            hint="a recipe that names them: flysid recipes sixdof --toml",
        )
    return found


def _whole_commands(data: Dataset, motors: Sequence[int], gyro: Sequence[int]) -> FloatArray:
    """(N, motors) commands as logged, without those that link losses invent."""
    parts = []
    for segment in data.segments:
        commands = segment.u[:, motors]
        parts.append(commands[~_lines_in(segment.y[:, gyro], commands, data.dt_s)])
    return np.concatenate(parts)


def _columns_of(data: Dataset, group: str) -> list[int] | None:
    names = [signal.name for signal in data.outputs]
    wanted = GROUPS[group]
    return [names.index(each) for each in wanted] if set(wanted) <= set(names) else None


def _read(
    data: Dataset,
    segment: Segment,
    motors: Sequence[int],
    volts: int | None,
    columns: Mapping[str, Sequence[int] | None],
    scale: Scale,
) -> Record:
    read = {name: None if at is None else segment.y[:, at] for name, at in columns.items()}
    voltage = None
    if volts is not None:
        if not (segment.u[:, volts] > 0.0).all():
            raise DataError("the voltage is not above 0 V throughout", hint="leave it out of the recipe")
        voltage = _averaged(segment.u[:, volts], data.dt_s)
    gyro = read["gyro"]
    assert gyro is not None
    attitude = read["attitude"]
    commands = (segment.u[:, motors] - scale.zero) / scale.full
    lost = _lines_in(gyro, commands, data.dt_s)
    return Record(
        segment.flight,
        data.dt_s,
        commands,
        voltage,
        gyro,
        read["force"],
        None if attitude is None else rotations.unit(attitude),
        read["velocity"],
        read["position"],
        lost,
        ~lost & ~beyond_full_scale(commands),
    )


def _averaged(voltage: FloatArray, dt_s: float) -> FloatArray:
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(voltage, max(round(VOLTAGE_S / dt_s), 1), mode="nearest"))


def _lines_in(gyro: FloatArray, commands: FloatArray, dt_s: float) -> BoolArray:
    """(N,) samples over which the link was lost."""
    return np.asarray(straight_lines(gyro, dt_s, standing=True) | straight_lines(commands, dt_s))


def _damage(records: Sequence[Record]) -> Damage:
    """Counted over all stretches of a flight, whose commands are not clipped yet."""
    lines = [record.lost for record in records]
    beyond = [beyond_full_scale(record.commands) for record in records]
    offsets = [
        clock_offsets(r.gyro[:-1], rotations.body_rates(r.attitude, r.dt_s), r.flying[:-1], r.dt_s)[1]
        for r in records
        if r.attitude is not None and len(r) > 1
    ]
    late = np.concatenate(offsets) if offsets else np.zeros(0)
    known = len(late) >= LEAST_WINDOWS
    return Damage(
        records[0].flight,
        samples=sum(map(len, records)),
        straight=int(sum(line.sum() for line in lines)),
        straight_runs=sum(len(runs(line)) for line in lines),
        beyond=int(sum(mask.sum() for mask in beyond)),
        most=max(float(np.abs(record.commands).max()) for record in records),
        clock_sd_s=float(late.std(ddof=1)) if known else None,
        clock_range_s=float(np.ptp(late)) if known else None,
    )


def _aloft(records: Sequence[Record]) -> list[Record]:
    """The records with commands within full scale, and with what flies marked."""
    ground: dict[str, float] = {}
    for record in records:
        if record.position is not None and record.flying.any():
            lowest = float(record.position[record.flying, 2].min())
            ground[record.flight] = min(lowest, ground.get(record.flight, lowest))
    found = []
    for record in records:
        flying = record.flying & (record.commands > TURNING).all(axis=1)
        if record.position is not None and record.flight in ground:
            flying &= record.position[:, 2] - ground[record.flight] > ALOFT_M
        found.append(replace(record, commands=_bridged(record), lost=~record.flying, flying=flying))
    return found


def _bridged(record: Record) -> FloatArray:
    """(N, motors) commands within full scale, those before and after a loss joined by straight lines.

    When telemetry is whole again motors still follow what the loss hid: never what it invents.
    """
    whole = np.flatnonzero(record.flying)
    if not len(whole):
        return np.clip(record.commands, 0.0, 1.0)
    every = np.arange(len(record))
    joined = [np.interp(every, whole, column) for column in record.commands[whole].T]
    return np.asarray(np.clip(np.stack(joined, axis=1), 0.0, 1.0))
