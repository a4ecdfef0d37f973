"""Facts about the battery: lowest voltage, resistance, sag and the charge that is left."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flysid.reviews.battery import Battery, lowest, measure_resistance, share_at_end, used_ah
from flysid.reviews.fact import Action, Fact, Finding, Grade, Picture, PictureLine
from flysid.reviews.figures import absent, exceeded, fact_of, limit
from flysid.reviews.logged import LoggedFlight

AT_END = 0.02
"""Share of samples at a current's highest value from which on it is the sensor's end: a peak has few."""


def facts(flight: LoggedFlight, battery: Battery, remedy: str) -> tuple[Fact, ...]:
    """Voltage, resistance, sag and charge; `remedy` logs the current."""
    if battery.voltage is None:
        return (absent("power.voltage_lowest", battery.missing, remedy),)
    return (*_voltage_facts(flight, battery), *_sag_facts(battery, remedy), *_charge_facts(flight, battery))


def _voltage_facts(flight: LoggedFlight, battery: Battery) -> Iterator[Fact]:
    assert battery.voltage is not None
    flown = battery.voltage.where(flight.flying(battery.voltage.time_s))
    if not len(flown):
        return
    volts, at_s = lowest(flown)
    fields = (battery.voltage.address,)
    yield fact_of("power.voltage_lowest", volts, fields, at_s=at_s)
    if battery.cells:
        cell, note = volts / battery.cells, f"{battery.cells} cells"
        yield fact_of("power.cell_lowest", cell, fields, note=note, at_s=at_s)
    else:
        missing = "the log does not state the number of cells, and the voltage fits none"
        yield absent("power.cell_lowest", missing, fields=fields)


def _sag_facts(battery: Battery, remedy: str) -> Iterator[Fact]:
    assert battery.voltage is not None
    if battery.current is None:
        yield absent("power.resistance", "no current is logged", remedy)
        return
    found = measure_resistance(battery.voltage, battery.current)
    amps = battery.current.values
    fields = (battery.voltage.address, battery.current.address)
    if found.missing:
        yield absent("power.resistance", found.missing, fields=fields)
        return
    low, high = found.interval
    yield fact_of("power.resistance", 1e3 * found.ohm, fields, interval=(1e3 * low, 1e3 * high))
    highest = float(np.percentile(amps, 99.9))
    ended = share_at_end(battery.current) >= AT_END and highest > 2.0 * float(np.median(amps))
    sag = found.ohm * highest
    yield fact_of(
        "power.sag",
        sag,
        fields,
        at_s=float(battery.current.time_s[np.argmax(amps)]),
        interval=(low * highest, high * highest),
        note=f"at {highest:.0f} A"
        + (", where the current sensor ends: the peak is not known" if ended else ""),
        grade=limit("power.sag").grade(sag / battery.cells) if battery.cells else Grade.PLAIN,
    )


def _charge_facts(flight: LoggedFlight, battery: Battery) -> Iterator[Fact]:
    drawn = used_ah(flight, battery.current)
    if drawn is not None and len(drawn) > 1:
        yield fact_of("power.used", 1e3 * float(drawn.values[-1] - drawn.values[0]), (drawn.address,))
    fields = [f"{thing}.RemPct" for thing in flight.things("BAT")[:1]]
    left = flight.quantity(*fields, "battery_status.remaining", unit="1")
    if left is None:
        return
    share = float(left.values[-1]) * (0.01 if left.values.max() > 1.5 else 1.0)
    if 0.0 <= share < 1.0:  # firmwares that do not know the capacity state all of it
        yield fact_of("power.left", 100.0 * share, (left.address,))


def findings(facts: tuple[Fact, ...]) -> Iterator[Finding]:
    """Sag, and a cell that falls low."""
    by_key = {fact.key: fact for fact in facts if isinstance(fact.value, float)}
    bad = exceeded(facts)
    cell, sag = by_key.get("power.cell_lowest"), by_key.get("power.sag")
    if sag is not None:
        at = sag.note.partition(";")[0].partition(",")[0]
        lowest_words = f"down to {cell.value:.2f} V a cell" if cell else ""
        weight = 0.75 if sag.key in bad else 0.25
        yield Finding(f"The battery sags {sag.value:.1f} V {at}", sag.grade, weight, sag.key, lowest_words)
    if cell is not None and cell.key in bad:
        weight = 0.4 if "power.sag" in bad else 0.74
        text, more = f"A battery cell falls to {cell.value:.2f} V", cell.note.partition("; ")[2]
        yield Finding(text, cell.grade, weight, cell.key, more)


def actions(facts: tuple[Fact, ...]) -> Iterator[Action]:
    """What to do about a battery that sags."""
    resistance = next((fact for fact in facts if fact.key == "power.resistance"), None)
    sag = exceeded(facts).get("power.sag")
    if sag is not None and resistance is not None:
        yield Action(
            "Check the battery, its leads and connectors, or fly a larger one",
            f"{resistance.words} of resistance: {sag.words} are lost {sag.note.partition(';')[0]}",
            predicted="half the resistance halves the sag",
            weight=0.6 if sag.grade is Grade.BAD else 0.45,
            fact="power.resistance",
        )


def picture(battery: Battery) -> Iterator[Picture]:
    """The voltage over time."""
    if battery.voltage is not None:
        line = PictureLine("voltage", battery.voltage.time_s, battery.voltage.values)
        yield Picture("Battery", "s", "V", (line,), f"{battery.cells} cells")
