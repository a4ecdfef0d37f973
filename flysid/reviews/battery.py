"""The battery of a log: its voltage and current, what it loses under load, what is left in it.

Its resistance is the slope of fast changes of the voltage over those of the current; slow ones empty it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.reviews.logged import Column, LoggedFlight

VOLTAGES = ("battery_status.voltage_v", "main.vbatLatest", "main.vbat", "SYS_STATUS.voltage_battery")
CURRENTS = ("battery_status.current_a", "main.amperageLatest", "main.amperage", "SYS_STATUS.current_battery")
FULL_CELL_V = 4.35
"""Of the fullest lithium cell: more is another cell."""
START_CELL_V = 3.6
"""Of a cell at the beginning of a log: less may be one cell too many, of a voltage that is not calibrated."""
LEAST_V = 2.0
"""Below it no battery is connected to the sensor."""


@dataclass(frozen=True, eq=False)
class Battery:
    """What a log holds of the battery.

    `voltage`, `current`: None where they are not logged.
    `cells`: in series; 0 where it is not known.
    `missing`: why there is no voltage, "" where there is one.
    """

    voltage: Column | None
    current: Column | None
    cells: int
    missing: str = ""


@dataclass(frozen=True)
class Resistance:
    """Inner resistance in ohm with its interval of 95 %; `missing` says why there is none."""

    ohm: float = float("nan")
    interval: tuple[float, float] = (float("nan"), float("nan"))
    missing: str = ""


def read_battery(flight: LoggedFlight) -> Battery:
    """The first battery of a log."""
    for message in ("BAT", "CURR"):
        for thing in flight.things(message)[:1]:
            voltage = flight.quantity(f"{thing}.Volt", unit="V", stated="V")
            current = flight.quantity(f"{thing}.Curr", unit="A", stated="A")
            return _checked(flight, voltage, current)
    return _checked(
        flight,
        flight.quantity(*VOLTAGES, unit="V", stated="V"),
        flight.quantity(*CURRENTS, unit="A", stated="A"),
    )


def _checked(flight: LoggedFlight, voltage: Column | None, current: Column | None) -> Battery:
    """Without sensors that are not connected: their readings stay near zero."""
    if voltage is None:
        return Battery(None, None, 0, "no battery voltage is logged")
    if np.median(voltage.values) < LEAST_V:
        return Battery(
            None, None, 0, f"the sensor reads {np.median(voltage.values):.2f} V: nothing is connected to it"
        )
    voltage = voltage.where(voltage.values >= LEAST_V)
    if current is not None and not (current.values > 0.0).any():
        current = None
    return Battery(voltage, current, _cells(flight, voltage))


def _cells(flight: LoggedFlight, voltage: Column) -> int:
    counted = flight.quantity("battery_status.cell_count")
    stated = float(np.median(counted.values)) if counted is not None else 0.0
    stated = stated or flight.parameters.get("BAT1_N_CELLS", 0.0) or flight.parameters.get("BAT_N_CELLS", 0.0)
    if stated > 0.0:
        return int(stated)
    first = float(np.median(voltage.values[:20]))
    counted_cells = int(np.ceil(first / FULL_CELL_V))
    return counted_cells if first / counted_cells >= START_CELL_V else 0


def measure_resistance(voltage: Column, current: Column, *, slow_s: float = 5.0) -> Resistance:
    """From changes faster than `slow_s`.

    >>> time_s = np.arange(0.0, 60.0, 0.1)
    >>> amps = 20.0 + 5.0 * np.sign(np.sin(2.0 * time_s))
    >>> volts = 16.0 - 0.01 * time_s - 0.025 * amps
    >>> found = measure_resistance(Column("V", "V", time_s, volts), Column("A", "A", time_s, amps))
    >>> round(found.ohm, 4)
    0.025
    """
    period_s = max(voltage.period_s, current.period_s)
    if not period_s > 0.0 or voltage.time_s[-1] - voltage.time_s[0] < 4.0 * slow_s:
        return Resistance(missing="too little of voltage and current is logged")
    time_s = np.arange(voltage.time_s[0], voltage.time_s[-1], max(period_s, 0.05))
    width = max(3, round(slow_s / max(period_s, 0.05)))
    fast_v, fast_a = (_without_slow(column.at(time_s), width) for column in (voltage, current))
    known = np.isfinite(fast_v) & np.isfinite(fast_a)
    fast_v, fast_a, block = fast_v[known], fast_a[known], (time_s[known] // slow_s).astype(int)
    power = float(fast_a @ fast_a)
    if len(fast_a) < 4 * width or power == 0.0:
        return Resistance(missing="the current does not change")
    slope = float(fast_a @ fast_v) / power
    left = fast_v - slope * fast_a
    scores = np.bincount(block - block.min(), weights=fast_a * left)
    deviation = float(np.sqrt(scores @ scores)) / power
    low, high = -slope - 1.96 * deviation, -slope + 1.96 * deviation
    if low <= 0.0:
        return Resistance(missing="the voltage does not fall when the current rises")
    return Resistance(-slope, (low, high))


def _without_slow(values: FloatArray, width: int) -> FloatArray:
    """Less their mean over a window of this many samples; NaN where it reaches beyond the ends."""
    sums = np.cumsum(np.concatenate([[0.0], values]))
    middle = (sums[width:] - sums[:-width]) / width
    found = np.full(len(values), np.nan)
    begin = width // 2
    found[begin : begin + len(middle)] = values[begin : begin + len(middle)] - middle
    return found


def lowest(voltage: Column, *, over_s: float = 0.5) -> tuple[float, float]:
    """The lowest voltage that lasted, and when: of medians over `over_s`, so that no single sample counts."""
    width = max(1, round(over_s * voltage.rate_hz))
    if width < 3 or len(voltage) < 2 * width:
        at = int(np.argmin(voltage.values))
        return float(voltage.values[at]), float(voltage.time_s[at])
    rows = len(voltage) // width
    medians = np.median(voltage.values[: rows * width].reshape(rows, width), axis=1)
    at = int(np.argmin(medians))
    return float(medians[at]), float(voltage.time_s[at * width + width // 2])


def share_at_end(current: Column, *, width: float = 0.005) -> float:
    """Share of samples within `width` of the highest one: a sensor that ends there stays there."""
    return float(np.mean(current.values >= current.values.max() * (1.0 - width)))


def used_ah(flight: LoggedFlight, current: Column | None) -> Column | None:
    """Charge drawn since the battery was connected, in Ah; else the current's integral."""
    for message in ("BAT", "CURR"):
        for thing in flight.things(message)[:1]:
            return flight.quantity(f"{thing}.CurrTot", unit="Ah", stated="mAh")
    stated = flight.quantity("battery_status.discharged_mah", unit="Ah", stated="mAh")
    if stated is not None or current is None:
        return stated
    steps = np.diff(current.time_s, prepend=current.time_s[0])
    steps[steps > 10.0 * current.period_s] = 0.0
    return replace(current, unit="Ah", values=np.cumsum(current.values * steps) / 3600.0)
