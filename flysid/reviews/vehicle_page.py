"""The page of a vehicle: its errors on other flights, what to fly next, its motors, every number."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from flysid.errors import UsageError
from flysid.export.vehicles.body import body_of
from flysid.export.vehicles.hover import hover_of
from flysid.extras import Missing
from flysid.reviews.fact import (
    Action,
    Drawn,
    Fact,
    Finding,
    Grade,
    Picture,
    PictureLine,
    Section,
    Table,
    TopView,
)
from flysid.reviews.lines import capital
from flysid.reviews.page import fill_answer, fill_page
from flysid.showing import counted, first_of, significant
from flysid.sixdof import layout
from flysid.sixdof.figures import Z95, VehicleNumber
from flysid.sixdof.fitted import FittedVehicle, FlightFacts
from flysid.sixdof.horizons import KINDS
from flysid.sixdof.judging import HORIZONS_S, Judgement
from flysid.sixdof.layout import AXES, CURVE, EFFECTS, INERTIA, LEAN, POWER, THRUST, TRIM
from flysid.sixdof.rigid_body import GRAVITY
from flysid.stretch import FloatArray
from flysid.validate.show.page.html import write_page

PAGE = "vehicle.html"
"""In the folder of a vehicle."""
POINTS = 61
"""Of a curve."""
FIRST_ACTIONS = 3
"""Flights to fly next on the first screen."""
NAMES = 4
"""Of numbers that a flight tells; the others are counted."""
SHOWN_UNITS = ("m", "m/s", "deg", "deg/s")
"""Of errors on the page, in the order of `KINDS`."""


def write_vehicle_page(
    path: str | Path, vehicle: FittedVehicle, judged: Judgement | None = None, command: str = ""
) -> Path:
    """Write the page whole or not at all; returns its path. The rest is as in `render_vehicle`.

    Raises StoreError: the file cannot be written.
    """
    return write_page(path, render_vehicle(vehicle, judged, command))


def render_vehicle(vehicle: FittedVehicle, judged: Judgement | None = None, command: str = "") -> str:
    """The page of a vehicle.

    `judged`: its errors on flights that were left out; None where it was not judged.
    `command`: that made it, for its foot.
    """
    missing = Missing()
    with missing.gathering():
        findings = list(_findings(vehicle, judged))
        shown = fill_answer(
            _head(vehicle),
            findings,
            _actions(vehicle),
            _sections(vehicle, judged),
            "flights that tell what these do not",
        )
    return fill_page(findings[0].text, [shown], command=command, absent=missing.sentences)


def _head(vehicle: FittedVehicle) -> str:
    seconds = sum(flight.seconds for flight in vehicle.flights)
    flights = counted(len(vehicle.flights), "flight")
    return f"vehicle with {vehicle.motors} motors, {flights}, {seconds:.0f} s, by {vehicle.method}"


def _findings(vehicle: FittedVehicle, judged: Judgement | None) -> Iterator[Finding]:
    """How far it predicts, and how much of it is known."""
    if judged is not None:
        grade = Grade.GOOD if judged.leads_all else Grade.PLAIN if judged.stands else Grade.WATCH
        for words in judged.words():
            text, _, more = words.partition(". ")
            yield Finding(capital(text), grade, 1.0, "", more)
            grade = Grade.PLAIN
    known = sum(number.is_determined for number in vehicle.numbers)
    text = f"{known} of {len(vehicle.numbers)} numbers are determined"
    more = "" if judged is not None else "no flight was left out to judge them"
    yield Finding(text, Grade.PLAIN if known else Grade.WATCH, 0.5, "", more)
    for doubt in vehicle.body.doubts if vehicle.body is not None else ():
        yield Finding(capital(doubt), Grade.WATCH, 0.5, "")


def _actions(vehicle: FittedVehicle) -> list[Action]:
    """The flights that tell most of what is not determined."""
    by_flight: dict[str, list[str]] = {}
    for number in vehicle.numbers:
        if not number.is_determined:
            by_flight.setdefault(number.flight, []).append(number.name)
    ranked = sorted(by_flight.items(), key=lambda item: -len(item[1]))[:FIRST_ACTIONS]
    return [Action(capital(flight), f"it tells {first_of(names, NAMES)}") for flight, names in ranked]


def _sections(vehicle: FittedVehicle, judged: Judgement | None) -> list[Section]:
    numbers = vehicle.numbers
    air = (*numbers[layout.ROTOR_DRAG : TRIM], *numbers[LEAN:INERTIA])
    turning = (*numbers[TRIM:LEAN], *numbers[INERTIA:EFFECTS])
    drawn = [top_view(vehicle), thrust_curve(vehicle)]
    pictures: list[Drawn] = [picture for picture in drawn if picture is not None]
    sections = [
        Section(
            "motors",
            "Motors",
            (*_lift(vehicle), *(_fact("motors", number) for number in numbers[: layout.ROTOR_DRAG])),
            shown=(*pictures, _effects(vehicle)),
        ),
        Section("air", "Air", tuple(_fact("air", number) for number in air)),
        Section("turning", "Turning", tuple(_fact("turning", number) for number in turning)),
    ]
    if vehicle.body is not None:
        facts = tuple(_fact("places", number) for number in vehicle.body.numbers)
        sections.append(Section("places", "From where the motors sit", facts))
    if judged is not None:
        sections.append(Section("ahead", f"Judged on {judged.tested}", shown=tuple(_errors(judged))))
    return [*sections, Section("flights", "What each flight gave", shown=tuple(_flights(vehicle)))]


def _fact(section: str, number: VehicleNumber) -> Fact:
    key = f"{section}.{re.sub('[^a-z0-9]+', '_', number.name)}"
    if not number.is_determined:
        return Fact(key, number.name, unit=number.unit, missing=number.reason, remedy=number.flight)
    return Fact(key, number.name, _words(number.value, number.half_width, number.unit))


def _words(value: float, half_width: float, unit: str) -> str:
    """A value with half its 95 % interval, as `flysid vehicle` prints them."""
    return f"{value:.4g} ± {half_width:.2g} {unit.replace('^2', '²')}".rstrip()


def _lift(vehicle: FittedVehicle) -> Iterator[Fact]:
    """What follows from thrust and its curve."""
    thrust = vehicle.numbers[THRUST]
    if not thrust.is_determined:
        return
    per_weight = vehicle.motors / GRAVITY
    words = _words(per_weight * thrust.value, per_weight * thrust.half_width, "")
    note = "of all motors, at the reference voltage"
    yield Fact("motors.thrust_to_weight", "full thrust over weight", words, note=note)


def top_view(vehicle: FittedVehicle) -> TopView | None:
    """Motors where their effects about roll and pitch place them; None where they have none."""
    try:
        places = body_of(vehicle).places
    except UsageError:
        return None
    known = _known_effects(vehicle)
    yaw = layout.effects(vehicle.theta)[2]
    return TopView(
        "From above",
        tuple((float(forward), float(-left)) for forward, left in places / np.abs(places).max()),
        tuple(str(i + 1) for i in range(vehicle.motors)),
        tuple(int(np.sign(yaw[i])) if known[2, i] else 0 for i in range(vehicle.motors)),
        tuple(bool(known[0, i] and known[1, i]) for i in range(vehicle.motors)),
        "placed by their effects; arrows show how rotors turn",
    )


def _known_effects(vehicle: FittedVehicle) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """(3, motors) whether the effect of a motor about an axis is determined."""
    known = [number.is_determined for number in vehicle.numbers[EFFECTS:]]
    return np.array(known).reshape(3, -1)


def _effects(vehicle: FittedVehicle) -> Table:
    """What each motor does at full thrust, about each axis."""
    motors = vehicle.motors
    rows = []
    for i in range(motors):
        own = [vehicle.numbers[EFFECTS + axis * motors + i] for axis in range(3)]
        cells = [
            _words(number.value, number.half_width, "") if number.is_determined else "not determined"
            for number in (*own, vehicle.numbers[THRUST])
        ]
        rows.append((str(i + 1), *cells))
    headings = ("motor", *(f"{axis}, rad/s²" for axis in AXES), "thrust, m/s² (alike)")
    return Table("At full thrust, with 95 % intervals", headings, tuple(rows))


def thrust_curve(vehicle: FittedVehicle) -> Picture | None:
    """Thrust of a motor over its command, from the least voltage that was flown to the largest."""
    thrust, curve, power = (vehicle.numbers[i] for i in (THRUST, CURVE, POWER))
    size = thrust.value if thrust.is_determined else 1.0
    commands = np.linspace(0.0, 1.0, POINTS)
    lines = [
        PictureLine(name, commands, size * _share(vehicle, commands, factor), style)
        for name, factor, style in _voltages(vehicle)
    ]
    if thrust.is_determined:
        lines.append(_band(vehicle, commands))
    lacking = [number.name for number in (thrust, curve, power) if not number.is_determined]
    marks = {}
    try:
        marks = {hover_of(vehicle).command: "hover"} if thrust.is_determined else {}
    except UsageError:
        lacking.append("hover")
    unit = "m/s² of the vehicle" if thrust.is_determined else "share of full"
    return Picture(
        "Thrust of a motor",
        "command, share of its range",
        unit,
        tuple(lines),
        f"not determined: {', '.join(lacking)}" if lacking else "",
        marks,
    )


def _voltages(vehicle: FittedVehicle) -> list[tuple[str, float, str]]:
    """(name, what commands are multiplied by, style) of the lines, the reference voltage first."""
    if not np.isfinite(vehicle.reference_v):
        return [("any voltage", 1.0, "measured")]
    lines = [(f"{significant(vehicle.reference_v)} V", 1.0, "measured")]
    if vehicle.flown_v is not None and vehicle.numbers[POWER].is_determined:
        power = float(vehicle.theta[POWER])
        for volts, style in zip(vehicle.flown_v, ("r5", "r2"), strict=True):
            lines.append((f"{significant(volts)} V", (volts / vehicle.reference_v) ** power, style))
    return lines


def _share(vehicle: FittedVehicle, commands: FloatArray, factor: float) -> FloatArray:
    """(N,) settled shares of full thrust."""
    curve = float(vehicle.theta[CURVE])
    speed = commands * factor
    return np.asarray((1.0 - curve) * speed + curve * speed**2)


def _band(vehicle: FittedVehicle, commands: FloatArray) -> PictureLine:
    """The edges of the 95 % interval at the reference voltage, as one broken line."""
    share = _share(vehicle, commands, 1.0)
    thrust = float(vehicle.theta[THRUST])
    by = np.stack([share, thrust * (commands**2 - commands)], axis=1)
    covariance = vehicle.covariance[np.ix_([THRUST, CURVE], [THRUST, CURVE])]
    width = Z95 * np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", by, covariance, by), 0.0))
    middle = thrust * share
    return PictureLine(
        "95 %",
        np.concatenate([commands, [np.nan], commands]),
        np.concatenate([middle - width, [np.nan], middle + width]),
        "mark",
    )


def _errors(judged: Judgement) -> Iterator[Table]:
    """Mean errors of every kind at every horizon that has starts, beside predictors that need no vehicle."""
    shown = [i for i, count in enumerate(judged.starts) if count]
    headings = ("predictor", *(f"{HORIZONS_S[i]:g} s, {judged.starts[i]} starts" for i in shown))
    for k, (kind, unit) in enumerate(zip(KINDS, SHOWN_UNITS, strict=True)):
        factor = 180.0 / np.pi if unit.startswith("deg") else 1.0
        rows = tuple(
            (name, *(significant(factor * float(table[i, k])) for i in shown))
            for name, table in judged.table.items()
        )
        yield Table(f"Mean error of {kind}, {unit}", headings, rows)


def _flights(vehicle: FittedVehicle) -> Iterator[Table]:
    """What of each flight was used, what it has of its own, and what was decided of all."""
    headings = ("flight", "used, s", "damaged, s", "wind, m/s", "gyro bias, deg/s", "force bias, m/s²")
    yield Table("Flights", headings, tuple(_flight_cells(flight) for flight in vehicle.flights))
    found = [(flight.name, words) for flight in vehicle.flights for words in flight.damage]
    found += [("all", words) for words in (*vehicle.close_pairs(), *vehicle.frames, *vehicle.notes)]
    if found:
        yield Table("What was found and decided", ("flight", "what"), tuple(found))


def _flight_cells(flight: FlightFacts) -> tuple[str, ...]:
    gyro = None if flight.gyro_bias is None else np.degrees(flight.gyro_bias).tolist()
    return (
        flight.name,
        f"{flight.seconds:.0f}",
        "-" if flight.lost_s is None else f"{flight.lost_s:.1f}",
        _triple(flight.wind),
        _triple(gyro),
        _triple(flight.force_bias),
    )


def _triple(values: Sequence[float] | None) -> str:
    """Numbers along axes; "-" where they are not known."""
    return "-" if values is None else ", ".join(significant(value, 2) for value in values)
