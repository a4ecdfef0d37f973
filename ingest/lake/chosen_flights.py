"""Which flights of a folder are meant, and whose they are: one model is of one vehicle."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace

from flysid.errors import UsageError
from flysid.facts.modes import family_of
from flysid.facts.vehicle import NAME, serial_of, vehicle_of
from flysid.ingest.align.recipe import Recipe, load_recipe
from flysid.ingest.align.signals import serves
from flysid.ingest.lake.events import settings
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.stretches import Stretches, parse_part

SHOWN = 5  # names in a message
OWN = (
    "SYSID_THISMAV",
    "MAV_SYS_ID",
    "BRD_SERIAL_NUM",
    "FRAME_CLASS",
    "FRAME_TYPE",
    "Q_FRAME_CLASS",
    "CA_AIRFRAME",
)
"""Parameters that a vehicle keeps while it is that vehicle: its number and its frame."""


@dataclass(frozen=True)
class Selection:
    """What a user says of the flights.

    `flights`: these alone, by id or the unambiguous beginning of it; empty: all.
    `exclude`: not these, by id or the unambiguous beginning of it.
    `vehicle`: those of this vehicle, by any part of its name that no other has; "": of all.
    `pool`: flights of several vehicles may be put together.
    `stretches`: what of every flight.
    """

    flights: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    vehicle: str = ""
    pool: bool = False
    stretches: Stretches = Stretches()  # noqa: RUF009 - frozen

    @property
    def options(self) -> list[str]:
        """As options of the command line."""
        left_out = (*self.exclude, *self.stretches.without)
        named = [("flight", self.flights), ("exclude", left_out), ("mode", self.stretches.modes)]
        found = [f"--{name} {shlex.quote(value)}" for name, values in named for value in values]
        found += [f"--vehicle {shlex.quote(self.vehicle)}"] if self.vehicle else []
        found += ["--pool"] if self.pool else []
        found += [f"--between {shlex.quote(self.stretches.between)}"] if self.stretches.between else []
        return [*found, *(["--keep-mishaps"] if self.stretches.mishaps else [])]


def select(lake: Lake, selection: Selection) -> Lake:
    """The flights that are meant.

    Raises UsageError: a name is of no flight, or of several; so is a vehicle's; nothing is left.
    """
    chosen = _name_flights(lake, selection.flights) or [facts.id for facts in lake.facts]
    excluded = set(_name_flights(lake, selection.exclude))
    left = lake.only([flight for flight in chosen if flight not in excluded])
    if selection.vehicle:
        name = _vehicle_named(left, selection.vehicle)
        left = left.only([facts.id for facts in left.facts if vehicle_of(facts.info) == name])
    if not left.facts and lake.facts:
        raise UsageError("no flight matches", path=lake.address or lake.folder, hint="exclude fewer")
    without = whole_ids(lake, selection.stretches.without)
    return replace(left, stretches=replace(selection.stretches, without=without))


def whole_ids(lake: Lake, parts: Sequence[str]) -> tuple[str, ...]:
    """Parts of flights (`parse_part`) by the flights' whole ids; raises UsageError."""
    read = [parse_part(text) for text in parts]
    return tuple(str(replace(part, flight=lake.find(part.flight))) for part in read)


def vehicles(lake: Lake) -> dict[str, list[str]]:
    """Vehicle -> ids of its flights. Flights that do not say whose they are belong to ""."""
    found: dict[str, list[str]] = {}
    for facts in lake.facts:
        found.setdefault(vehicle_of(facts.info), []).append(facts.id)
    return found


def vehicle_words(lake: Lake) -> dict[str, str]:
    """Flight -> what `--vehicle` takes for its vehicle; nothing where one vehicle is known at most."""
    known = {name: ids for name, ids in vehicles(lake).items() if name}
    if len(known) < 2:
        return {}
    return {flight: shortest_end(name, list(known)) for name, ids in known.items() for flight in ids}


def of_one_vehicle(lake: Lake, recipe: str) -> Lake:
    """The flights, or those with the streams of a recipe where these alone are of one vehicle.

    `recipe`: "" for none.
    Raises UsageError: as `require_one_vehicle`, of the flights that have the streams.
    """
    able = _serving(lake, load_recipe(recipe)) if recipe and len(vehicles(lake)) > 1 else lake
    chosen = able if able.facts else lake
    require_one_vehicle(chosen)
    return chosen


def require_one_vehicle(lake: Lake) -> None:
    """Raise UsageError where flights are known to be of several vehicles: a model of all is none of any.

    Logs without a serial number are distinguished by the kind of vehicle and by its parameters `OWN`.
    """
    known = {name: ids for name, ids in vehicles(lake).items() if name}
    if len(known) > 1:
        told = "; ".join(f"{name}: {_count(ids)}" for name, ids in list(known.items())[:SHOWN])
        more = f"; and {len(known) - SHOWN} more" if len(known) > SHOWN else ""
        example = shortest_end(max(known, key=lambda name: len(known[name])), list(known))
        raise UsageError(
            f"flights of {len(known)} vehicles: {told}{more}",
            path=lake.address or lake.folder,
            hint=f"--vehicle {example!r} for one of them, --pool to put them together",
        )
    for fact, stated in _state(lake).items():
        if len(stated) > 1:
            told = "; ".join(f"{value}: {_count(ids)}" for value, ids in list(stated.items())[:SHOWN])
            raise UsageError(
                f"flights of {len(stated)} vehicles, by {fact}: {told}",
                path=lake.address or lake.folder,
                hint="--flight or --exclude for those of one of them, --pool to put them together",
            )


def _serving(lake: Lake, recipe: Recipe) -> Lake:
    """The flights that have the streams of a channel."""
    able = [log.name for log in lake.logs if any(serves(log, recipe, name) for name in recipe.channels)]
    return lake.only(able)


def _state(lake: Lake) -> dict[str, dict[str, list[str]]]:
    """What flights without a serial number say of their vehicle: fact -> value -> ids of the flights."""
    found: dict[str, dict[str, list[str]]] = {}
    if len(lake.facts) < 2:
        return found
    for log in lake.logs:
        info = log.facts.info
        if info.get(NAME) or serial_of(info):
            continue
        said = {
            s.name: f"{s.value:g}" for s in settings(log) if s.name in OWN and not isinstance(s.value, str)
        }
        kind = info.get("vehicle", "").lower()
        if family_of(kind) == "copter" != kind:  # a log on board says "copter" of every kind
            said["kind"] = kind
        for fact, value in said.items():
            found.setdefault(fact, {}).setdefault(value, []).append(log.facts.id)
    return found


def _name_flights(lake: Lake, names: Sequence[str]) -> list[str]:
    held = {facts.id for facts in lake.facts}
    found = [lake.find(name) for name in names]
    return [flight for flight in dict.fromkeys(found) if flight in held]


def _vehicle_named(lake: Lake, part: str) -> str:
    names = [name for name in vehicles(lake) if name]
    found = [name for name in names if name == part] or [
        name for name in names if part.lower() in name.lower()
    ]
    if len(found) == 1:
        return found[0]
    raise UsageError(
        f"{part!r} names {len(found)} vehicles" if found else f"no vehicle {part!r} in these flights",
        path=lake.address or lake.folder,
        hint="; ".join((found or names)[:SHOWN]) or "leave out --vehicle: the logs do not name theirs",
    )


def shortest_end(name: str, others: Sequence[str]) -> str:
    """The shortest end of a name, at least six characters, that no other vehicle's name holds."""
    for length in range(6, len(name)):
        end = name[-length:]
        if sum(end.lower() in other.lower() for other in others) == 1:
            return end
    return name


def _count(ids: Sequence[str]) -> str:
    return f"{len(ids)} flights" if len(ids) > 1 else f"1 flight, {ids[0]}"
