"""Which flights of a folder are meant, and whose they are: one model is of one vehicle."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace

from flysid.errors import UsageError
from flysid.ingest.align.vehicle import vehicle_of
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.stretches import Stretches

SHOWN = 5  # names in a message


@dataclass(frozen=True)
class Selection:
    """What a user says of the flights.

    Attributes
    ----------
    flights : these alone, by id or the unambiguous beginning of it; empty: all.
    exclude : not these, by id or the unambiguous beginning of it.
    vehicle : those of this vehicle, by any part of its name that no other has; "": of all.
    pool : flights of several vehicles may be put together.
    stretches : what of every flight.
    """

    flights: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    vehicle: str = ""
    pool: bool = False
    stretches: Stretches = Stretches()  # noqa: RUF009 - frozen

    @property
    def options(self) -> list[str]:
        """As options of the command line."""
        named = [("flight", self.flights), ("exclude", self.exclude), ("mode", self.stretches.modes)]
        found = [f"--{name} {shlex.quote(value)}" for name, values in named for value in values]
        found += [f"--vehicle {shlex.quote(self.vehicle)}"] if self.vehicle else []
        found += ["--pool"] if self.pool else []
        found += [f"--between {self.stretches.between}"] if self.stretches.between else []
        return [*found, *(["--keep-mishaps"] if self.stretches.mishaps else [])]


def select(lake: Lake, selection: Selection) -> Lake:
    """The flights that are meant.

    Raises
    ------
    UsageError : a name is of no flight, or of several; so is a vehicle's; nothing is left.
    """
    chosen = _named(lake, selection.flights) or [facts.id for facts in lake.facts]
    excluded = set(_named(lake, selection.exclude))
    left = lake.only([flight for flight in chosen if flight not in excluded])
    if selection.vehicle:
        name = _vehicle_named(left, selection.vehicle)
        left = left.only([facts.id for facts in left.facts if vehicle_of(facts.info) == name])
    if not left.facts and lake.facts:
        raise UsageError("no flight is left", path=lake.address or lake.folder, hint="exclude fewer")
    return replace(left, stretches=selection.stretches)


def vehicles(lake: Lake) -> dict[str, list[str]]:
    """Vehicle -> ids of its flights. Flights that do not say whose they are belong to ""."""
    found: dict[str, list[str]] = {}
    for facts in lake.facts:
        found.setdefault(vehicle_of(facts.info), []).append(facts.id)
    return found


def require_one_vehicle(lake: Lake) -> None:
    """Raise UsageError where flights are known to be of several vehicles: a model of all is none of any."""
    known = {name: ids for name, ids in vehicles(lake).items() if name}
    if len(known) < 2:
        return
    told = "; ".join(f"{name}: {_counted(ids)}" for name, ids in list(known.items())[:SHOWN])
    more = f"; and {len(known) - SHOWN} more" if len(known) > SHOWN else ""
    example = shortest_end(max(known, key=lambda name: len(known[name])), list(known))
    raise UsageError(
        f"flights of {len(known)} vehicles: {told}{more}",
        path=lake.address or lake.folder,
        hint=f"--vehicle {example!r} for one of them, --pool to put them together",
    )


def _named(lake: Lake, names: Sequence[str]) -> list[str]:
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
        hint="; ".join((found or names)[:SHOWN]) or "the logs do not say whose they are",
    )


def shortest_end(name: str, others: Sequence[str]) -> str:
    """The shortest end of a name, at least six characters, that no other vehicle's name holds."""
    for length in range(6, len(name)):
        end = name[-length:]
        if sum(end.lower() in other.lower() for other in others) == 1:
            return end
    return name


def _counted(ids: Sequence[str]) -> str:
    return f"{len(ids)} flights" if len(ids) > 1 else f"1 flight, {ids[0]}"
