"""Lake: an ingested folder, its flights, and the datasets that recipes make of it."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, overload

import pyarrow as pa

from flysid.catalogue import FlightFacts, catalogue
from flysid.dataset import Dataset
from flysid.errors import DataError, RecipeError, UsageError
from flysid.facts.vehicle import label_of
from flysid.flight import ClockMap, Flight
from flysid.ingest.align.align import Aligned, align, align_to_file
from flysid.ingest.align.allowed import Allowed
from flysid.ingest.align.recipe import Recipe, load_recipe, shipped_recipes
from flysid.ingest.align.report import AlignReport
from flysid.ingest.align.signals import find_source, serves
from flysid.ingest.formats.keyed import keys_in
from flysid.ingest.lake.stretches import Stretches
from flysid.manifest import (
    DATA_FILE,
    FLIGHTS,
    MANIFEST_FILE,
    Manifest,
    check_data_folder,
    check_lake,
    content_stamp,
    find_flight,
    find_named,
    folder_names,
    read_manifest,
)
from flysid.mirror import address_of, forget
from flysid.place import Place, is_address
from flysid.showing import Shown, Table, counted
from flysid.store import mirror_of, read_entry, read_flight

if TYPE_CHECKING:
    from flysid.ingest.lake.suggest import Suggestion


@dataclass(frozen=True, eq=False)
class StoredLog:
    """A stored flight for alignment: its manifest and its columns are read when they are needed."""

    folder: Path
    facts: FlightFacts
    stretches: Stretches = Stretches()  # noqa: RUF009 - frozen

    @property
    def name(self) -> str:
        return self.facts.id

    @property
    def rows(self) -> Mapping[str, int]:
        """Rows of every stream, by key."""
        return self.facts.streams

    @property
    def info(self) -> Mapping[str, str]:
        """Facts about the vehicle."""
        return self.facts.info

    @property
    def clocks(self) -> tuple[ClockMap, ...]:
        """One for every boot, in order."""
        return self.manifest.clocks

    @cached_property
    def allowed(self) -> Allowed:
        """Where it may be used."""
        return self.stretches.allowed(self)

    @cached_property
    def manifest(self) -> Manifest:
        """All that is known of the flight without its tables."""
        return read_manifest(self.folder / FLIGHTS / self.facts.id)

    def columns(self, stream: str) -> Sequence[str]:
        """Names of a stream's columns."""
        return [c.name for c in self.manifest.stream(stream).columns]

    def keys(self, stream: str) -> Sequence[str]:
        """The fields that tell to which of several things a stream's rows belong."""
        return keys_in(self.manifest.stream(stream).metadata)

    def table(self, stream: str, columns: Sequence[str]) -> pa.Table:
        """Some columns of a stream."""
        return read_entry(self.folder / FLIGHTS / self.name, self.manifest.stream(stream), columns)


class Manifests(Sequence[Manifest]):
    """Manifests of flights, each read from its folder on access, and not kept."""

    def __init__(self, folder: Path, ids: Sequence[str]) -> None:
        self._folder = folder
        self._ids = ids

    def __len__(self) -> int:
        return len(self._ids)

    @overload
    def __getitem__(self, index: int) -> Manifest: ...
    @overload
    def __getitem__(self, index: slice) -> Manifests: ...
    def __getitem__(self, index: int | slice) -> Manifest | Manifests:
        if isinstance(index, slice):
            return Manifests(self._folder, self._ids[index])
        return read_manifest(self._folder / FLIGHTS / self._ids[index])


@dataclass(frozen=True, eq=False, repr=False)
class Lake(Shown):
    """An ingested folder.

    Attributes
    ----------
    folder : where it is; what of it has been read, where `address` is given.
    facts : what its catalogue holds of its flights, by id.
    stretches : what of every flight is used.
    address : of the object store that it is in; "" where it is in `folder`.
    """

    folder: Path
    facts: tuple[FlightFacts, ...]
    stretches: Stretches = Stretches()  # noqa: RUF009 - frozen
    address: str = ""

    @property
    def place(self) -> str:
        """Its address, or its folder's absolute path: what `open` takes from anywhere."""
        return self.address or os.path.abspath(self.folder)

    def __len__(self) -> int:
        return len(self.facts)

    def _table(self) -> Table:
        rows = [
            (
                f.id,
                f.format,
                label_of(f.info),
                f"{f.duration_s:.0f}",
                f"{f.rows:,}",
                "yes" if f.lost else "-",
            )
            for f in self.facts
        ]
        seconds = sum(f.duration_s for f in self.facts)
        minutes = f"{seconds / 60.0:,.{0 if seconds >= 600.0 else 1}f} min"
        title = f"{self.address or self.folder}: {counted(len(rows), 'flight')}, {minutes}"
        return Table(title, ("flight", "format", "vehicle", "seconds", "records", "lost"), rows)

    def __iter__(self) -> Iterator[Manifest]:
        return iter(self.flights)

    @property
    def flights(self) -> Manifests:
        """The manifests of the flights, by id; each is read on access."""
        return Manifests(self.folder, [facts.id for facts in self.facts])

    @cached_property
    def logs(self) -> tuple[StoredLog, ...]:
        """The flights as alignment reads them."""
        return tuple(StoredLog(self.folder, facts, self.stretches) for facts in self.facts)

    def only(self, flights: Collection[str]) -> Lake:
        """The same folder with these flights alone, by their whole ids."""
        wanted = frozenset(flights)
        return replace(self, facts=tuple(facts for facts in self.facts if facts.id in wanted))

    def flight(self, flight: str) -> Flight:
        """A flight in memory, by its id or the unambiguous beginning of it."""
        return read_flight(self.folder, self.find(flight))

    def find(self, flight: str) -> str:
        """The id of the flight whose id is, or unambiguously begins with, `flight`; raises UsageError."""
        if self.address:
            return find_named(flight, [facts.id for facts in self.facts], self.address)
        return find_flight(self.folder, flight).id

    def recipes(self) -> dict[str, tuple[str, ...]]:
        """Shipped recipes that at least one flight can serve -> the channels it can serve."""
        served = {name: self.channels(load_recipe(name)) for name in shipped_recipes()}
        return {name: channels for name, channels in served.items() if channels}

    def channels(self, recipe: Recipe | str | Path) -> tuple[str, ...]:
        """Channels of a recipe that at least one flight holds all signals of."""
        recipe = _as_recipe(recipe)
        unlike = {
            log.facts.layout: log for log in self.logs
        }.values()  # of those with equal columns, one tells
        return tuple(name for name in recipe.channels if any(serves(log, recipe, name) for log in unlike))

    def align(self, recipe: Recipe | str | Path, channel: str) -> Aligned:
        """The dataset of a channel and how it was made; raises as `flysid.ingest.align.align`."""
        return align(self.logs, _as_recipe(recipe), channel)

    def dataset(self, recipe: Recipe | str | Path, channel: str) -> Dataset:
        """The dataset of a channel; raises as `flysid.ingest.align.align.align`."""
        return self.align(recipe, channel).dataset

    def expected_samples(self, recipe: Recipe | str | Path, channel: str) -> int:
        """About as many samples as the channel's dataset will have: rows of its slowest paced source."""
        recipe = _as_recipe(recipe)
        specs = [recipe.signals[name] for name in recipe.signals_of(channel)]
        paced = [s for s in specs if s.max_gap_s != float("inf")] or specs
        total = 0
        for log in self.logs:
            found = [find_source(s.sources, log) for s in paced]
            total += min((log.rows[source[1]] for source in found if source is not None), default=0)
        return total

    def write(self, recipe: Recipe | str | Path, channel: str, path: str | Path) -> AlignReport:
        """The dataset of a channel into a parquet file, in bounded memory; see `align_to_file`."""
        return align_to_file(path, self.logs, _as_recipe(recipe), channel)

    def datasets(self, recipe: Recipe | str | Path) -> dict[str, Dataset]:
        """Datasets of all channels of a recipe that the flights can serve.

        Channels without streams, excitation or length are left out; where none is left, the first
        channel's error is raised.
        """
        recipe = _as_recipe(recipe)
        found: dict[str, Dataset] = {}
        errors: list[RecipeError | DataError] = []
        for name in recipe.channels:
            try:
                found[name] = self.dataset(recipe, name)
            except (RecipeError, DataError) as error:
                errors.append(error)
        if not found:
            raise errors[0]
        return found

    def suggest(self, recipes: Sequence[str | Recipe] | None = None) -> list[Suggestion]:
        """What each flight supports, how well, and what to log or fly next."""
        from flysid.ingest.lake.suggest import suggest  # compiled filters: not for those who only look

        return suggest(self.logs, recipes)

    def channel(self, name: str, recipe: Recipe | str | Path | None = None) -> Dataset:
        """The dataset of a channel of the given recipe, or of the only shipped recipe that serves it here.

        Raises
        ------
        UsageError : no recipe serves the channel, or several do.
        """
        if recipe is not None:
            return self.dataset(recipe, name)
        served = self.recipes()
        having = [r for r, channels in served.items() if name in channels]
        if len(having) == 1:
            return self.dataset(having[0], name)
        if having:
            raise UsageError(
                f"channel {name!r} is in {len(having)} recipes",
                hint='recipe="' + '", or "'.join(having) + '"',
            )
        offered = ", ".join(dict.fromkeys(c for channels in served.values() for c in channels))
        raise UsageError(
            f"no recipe gives channel {name!r} from these flights",
            path=self.folder,
            hint=offered or "recipe=...",
        )


def open(folder: str | Path, where: str = "") -> Lake:  # noqa: A001
    """Open an ingested folder, or a lake in an object store (`s3://bucket/lake`; needs `flysid[fleet]`).

    Parameters
    ----------
    where : a condition in SQL that flights meet, e.g. "vehicle = 'v017' and start > '2026-10-01'"; of a lake
        alone. `flysid fleet ls --sql` says which columns there are.

    Raises
    ------
    UsageError : there is no such folder, or `flysid ingest` did not make it; the condition is not understood.
    StoreError : a manifest is damaged or of another version.
    PlaceError : the store does not answer.

    Examples
    --------
    >>> lake = flysid.open("data")  # flysid ingest sample_logs/01-steps-seed2.tlog -o data
    >>> len(lake.flights)
    1
    """
    address = str(folder) if is_address(folder) else address_of(Path(folder))
    if address:
        return _open_lake(Place(address), where)
    if where:
        raise UsageError("a condition needs the catalogue of a lake in an object store", path=folder)
    path = check_data_folder(folder)
    return Lake(path, catalogue(path))


def _open_lake(place: Place, where: str) -> Lake:
    """The flights of a lake from its table; what has been read of a flight that has changed is dropped."""
    from flysid.ingest.lake.flighttable import facts_in, select

    document = place.read_if_there(DATA_FILE)
    if document is None:
        raise UsageError(
            "no lake there: it has no " + DATA_FILE,
            path=place.address,
            hint=f"make it with: flysid ingest LOG... -o {place}",
        )
    check_lake(document, place.address)
    facts = facts_in(select(place, where))
    return Lake(mirror(str(place), facts), facts, address=str(place))


def mirror(address: str, facts: Sequence[FlightFacts]) -> Path:
    """The mirror of a lake; what has been read of these flights is dropped where they have changed since."""
    folder = mirror_of(address)
    known = {flight.id: flight.stamp for flight in facts}
    for name in folder_names(folder):
        manifest = folder / FLIGHTS / name / MANIFEST_FILE
        if name in known and manifest.is_file() and content_stamp(manifest.read_bytes()) != known[name]:
            forget(folder, name)
    return folder


def _as_recipe(recipe: Recipe | str | Path) -> Recipe:
    return recipe if isinstance(recipe, Recipe) else load_recipe(recipe)
