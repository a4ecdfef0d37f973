"""What a review states of the battery: its lowest voltage, resistance, sag, and the charge that is left."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flysid.reviews.battery import (
    Battery,
    Resistance,
    lowest,
    measure_resistance,
    share_at_end,
    used_ah,
)
from flysid.reviews.fact import Action, Fact, Finding, Grade, Line, Picture
from flysid.reviews.limits import limit
from flysid.reviews.logged import LoggedFlight

AT_END = 0.02
"""Share of samples at a current's highest value from which on it is the sensor's end: a peak has few."""


def facts(flight: LoggedFlight, battery: Battery, remedy: str) -> tuple[Fact, ...]:
    """Voltage, resistance, sag and charge; `remedy` logs the current."""
    if battery.voltage is None:
        return (Fact("power.voltage_lowest", "lowest voltage", missing=battery.missing, remedy=remedy),)
    return (*_voltage_facts(flight, battery), *_sag_facts(battery, remedy), *_charge_facts(flight, battery))


def _voltage_facts(flight: LoggedFlight, battery: Battery) -> Iterator[Fact]:
    assert battery.voltage is not None
    flown = battery.voltage.where(flight.flying(battery.voltage.time_s))
    if not len(flown):
        return
    volts, at_s = lowest(flown)
    fields = (battery.voltage.address,)
    yield Fact("power.voltage_lowest", "lowest voltage", volts, "V", fields=fields, at_s=at_s)
    if not battery.cells:
        missing = "the log does not state the number of cells, and the voltage fits none"
        yield Fact("power.cell_lowest", "lowest voltage of a cell", missing=missing, fields=fields)
        return
    known = limit("power.cell_voltage")
    cell = volts / battery.cells
    yield Fact(
        "power.cell_lowest",
        "lowest voltage of a cell",
        cell,
        "V",
        grade=known.grade(cell),
        note=f"{battery.cells} cells; {known.source}",
        fields=fields,
        at_s=at_s,
    )


def _sag_facts(battery: Battery, remedy: str) -> Iterator[Fact]:
    assert battery.voltage is not None
    if battery.current is None:
        missing = "no current is logged"
        yield Fact("power.resistance", "battery resistance", missing=missing, remedy=remedy)
        return
    found: Resistance = measure_resistance(battery.voltage, battery.current)
    fields = (battery.voltage.address, battery.current.address)
    if found.missing:
        yield Fact("power.resistance", "battery resistance", missing=found.missing, fields=fields)
        return
    milliohm = (1e3 * found.interval[0], 1e3 * found.interval[1])
    yield Fact("power.resistance", "battery resistance", 1e3 * found.ohm, "mohm", milliohm, fields=fields)
    highest = float(np.percentile(battery.current.values, 99.9))
    ended = share_at_end(battery.current) >= AT_END and highest > 2.0 * float(
        np.median(battery.current.values)
    )
    known = limit("power.cell_sag")
    note = f"at {highest:.0f} A; {known.source}"
    if ended:
        note = f"at {highest:.0f} A, where the current sensor ends: the peak is not known; {known.source}"
    sag = found.ohm * highest
    grade = known.grade(sag / battery.cells) if battery.cells else Grade.PLAIN
    interval = (found.interval[0] * highest, found.interval[1] * highest)
    yield Fact(
        "power.sag",
        "battery sag at the highest current",
        sag,
        "V",
        interval,
        grade,
        note,
        fields,
        at_s=float(battery.current.time_s[np.argmax(battery.current.values)]),
    )


def _charge_facts(flight: LoggedFlight, battery: Battery) -> Iterator[Fact]:
    drawn = used_ah(flight, battery.current)
    if drawn is not None and len(drawn) > 1:
        used = float(drawn.values[-1] - drawn.values[0])
        yield Fact("power.used", "charge used", 1e3 * used, "mAh", fields=(drawn.address,))
    fields = [f"{thing}.RemPct" for thing in flight.things("BAT")[:1]]
    left = (
        flight.quantity(*fields, "battery_status.remaining", unit="1")
        if fields or flight.has("battery_status")
        else None
    )
    if left is None:
        return
    share = float(left.values[-1]) * (0.01 if left.values.max() > 1.5 else 1.0)
    if not 0.0 <= share < 1.0:
        return  # firmwares that do not know the capacity state all of it
    known = limit("power.left")
    yield Fact(
        "power.left",
        "charge left at the end",
        100.0 * share,
        "%",
        grade=known.grade(share),
        note=known.source,
        fields=(left.address,),
    )


def findings(facts: tuple[Fact, ...]) -> Iterator[Finding]:
    """Sag, a cell that falls low, an empty battery."""
    by_key = {fact.key: fact for fact in facts}
    cell, sag, left = (by_key.get(f"power.{key}") for key in ("cell_lowest", "sag", "left"))
    if sag is not None and isinstance(sag.value, float):
        at = sag.note.partition(";")[0].partition(",")[0]
        words = f"The battery sags {sag.value:.1f} V {at}"
        lowest_words = f"down to {cell.value:.2f} V a cell" if cell and isinstance(cell.value, float) else ""
        yield Finding(words, sag.grade, 0.75 if _is_bad(sag) else 0.25, "power.sag", lowest_words)
    if cell is not None and _is_bad(cell) and isinstance(cell.value, float):
        low = not (sag is not None and _is_bad(sag))
        text = f"A battery cell falls to {cell.value:.2f} V"
        yield Finding(
            text, cell.grade, 0.74 if low else 0.4, "power.cell_lowest", cell.note.partition("; ")[2]
        )
    if left is not None and _is_bad(left) and isinstance(left.value, float):
        yield Finding(
            f"The battery ends with {left.value:.0f} % of its charge",
            left.grade,
            0.5,
            "power.left",
            left.note,
        )


def _is_bad(fact: Fact) -> bool:
    return fact.grade.rank >= Grade.WATCH.rank


def actions(facts: tuple[Fact, ...]) -> Iterator[Action]:
    """What to do about a battery that sags."""
    by_key = {fact.key: fact for fact in facts}
    sag, resistance = by_key.get("power.sag"), by_key.get("power.resistance")
    if sag is None or resistance is None or not _is_bad(sag):
        return
    yield Action(
        "Check the battery, its leads and connectors, or fly a larger one",
        f"{resistance.words} of resistance: {sag.words} are lost {sag.note.partition(';')[0]}",
        predicted="half the resistance halves the sag",
        weight=0.6 if sag.grade is Grade.BAD else 0.45,
        fact="power.resistance",
    )


def picture(battery: Battery) -> Iterator[Picture]:
    """The voltage over time."""
    if battery.voltage is None:
        return
    lines = [Line("voltage", battery.voltage.time_s, battery.voltage.values)]
    yield Picture("Battery", "s", "V", tuple(lines), f"{battery.cells} cells")
