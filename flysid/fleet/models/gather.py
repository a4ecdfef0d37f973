"""Pass one: compute the triangles of a fleet's flights; each flight is read once a recipe."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from flysid.errors import DataError, FlysidError, RecipeError
from flysid.facts.vehicle import vehicle_of
from flysid.fleet.models.band import ComplexArray
from flysid.fleet.models.common_grid import Sampling, choose_sampling, spread
from flysid.fleet.models.differences import FlightPart
from flysid.fleet.models.triangle_store import Objects, TriangleRow, TriangleStore, Unfit, row_of
from flysid.fleet.models.triangles import Triangle, triangle_of
from flysid.ingest.align.align import align, segments_of
from flysid.ingest.align.recipe import Recipe
from flysid.ingest.lake.lake import Lake, StoredLog, mirror
from flysid.ingest.lake.workers import Bounds, Lost, run_bounded
from flysid.model.threads import on_one_thread
from flysid.progress import tell

if TYPE_CHECKING:
    from flysid.fleet.cluster import Cluster

PILOTS = 16
"""Flights from which a channel's grid is chosen."""
BATCH = 32
"""Flights in a task and in a part."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """What is kept of a fleet.

    `samplings`, `parts`: by channel.
    `skipped`: channels that the fleet cannot serve, and why.
    `read`: flights that were read for it now.
    `lost`: flights whose reading ended its process, and why.
    """

    samplings: Mapping[str, Sampling]
    parts: Mapping[str, list[FlightPart]]
    skipped: Mapping[str, str]
    read: int
    lost: Mapping[str, str]


@dataclass(frozen=True)
class Batch:
    """Flights to be read at once, with the grids of the channels.

    `address`: of the lake, from where a process on another machine reads them; "": they lie in their folder.
    """

    logs: tuple[StoredLog, ...]
    recipe: Recipe
    samplings: Mapping[str, Sampling]
    address: str


def gather(
    lake: Lake,
    recipe: Recipe,
    objects: Objects,
    channels: Sequence[str] = (),
    rate_hz: float | None = None,
    workers: int = 1,
    cluster: Cluster | None = None,
) -> Gathered:
    """The triangles of all flights; those that are kept already are not read.

    `objects`: where they are kept: the lake's own place.
    `channels`: of the recipe; empty: all.
    `rate_hz`: of the grid; None: from where output and input are coherent.
    `workers`: processes at a time; 1: in this one.
    `cluster`: reads flights instead of this machine's processes; the lake must have an address.
    Raises RecipeError: no such channel.
    """
    store = TriangleStore(objects, recipe, rate_hz)
    samplings: dict[str, Sampling] = {}
    skipped: dict[str, str] = {}
    for channel in channels or tuple(recipe.channels):
        recipe.channel(channel)
        found = _sampling(lake, recipe, channel, store, rate_hz)
        if isinstance(found, Unfit):
            skipped[channel] = found.reason
        else:
            samplings[channel] = found
    known = store.known()
    missing = [
        log for log in lake.logs if any((log.name, log.facts.sha256, c) not in known for c in samplings)
    ]
    lost: dict[str, str] = {}
    tasks = [
        Batch(tuple(missing[i : i + BATCH]), recipe, samplings, lake.address)
        for i in range(0, len(missing), BATCH)
    ]
    for done, (batch, rows) in enumerate(_work(tasks, workers, cluster), start=1):
        if isinstance(rows, Lost):
            lost |= {log.name: rows.reason for log in batch.logs}
            continue
        store.keep([r for r in rows if (r.flight, r.sha256, r.channel) not in known])
        tell(f"{min(done * BATCH, len(missing))} of {len(missing)} flights", share=done / len(tasks))
    flights = {facts.id: facts.sha256 for facts in lake.facts}
    parts = {channel: store.parts(channel, sampling, flights) for channel, sampling in samplings.items()}
    return Gathered(samplings, parts, skipped, len(missing) - len(lost), lost)


def _work(
    tasks: Sequence[Batch], workers: int, cluster: Cluster | None
) -> Iterator[tuple[Batch, list[TriangleRow] | Lost]]:
    if cluster is not None:
        for task, rows in cluster.each(rows_elsewhere, tasks, _parts_of):
            yield (
                task,
                Lost(FlysidError("the processes that read it were killed"), 0) if rows is None else rows,
            )
        return
    if workers <= 1 or len(tasks) == 1:
        for task in tasks:
            yield task, rows_of(task)
        return
    yield from run_bounded(rows_of, tasks, workers, Bounds(seconds=None))


def _parts_of(batch: Batch) -> list[str]:
    return ["triangles", repr(batch.recipe), repr(batch.samplings), *(log.facts.sha256 for log in batch.logs)]


def rows_elsewhere(batch: Batch) -> list[TriangleRow]:
    """The rows of a batch on a machine that has the lake's address alone."""
    folder = mirror(batch.address, [log.facts for log in batch.logs])
    return rows_of(replace(batch, logs=tuple(replace(log, folder=folder) for log in batch.logs)))


@on_one_thread
def rows_of(batch: Batch) -> list[TriangleRow]:
    """The rows of a batch's flights and channels; needs nothing but the flights."""
    rows = []
    for log in batch.logs:
        for channel, sampling in batch.samplings.items():
            part, reason = part_of_log(log, batch.recipe, channel, sampling)
            rows.append(row_of(part, log.facts.sha256, channel, reason))
    return rows


def part_of_log(log: StoredLog, recipe: Recipe, channel: str, sampling: Sampling) -> tuple[FlightPart, str]:
    """A flight's part of a channel, and why it is empty."""
    signals = len(sampling.inputs) + len(sampling.outputs)
    none: ComplexArray = np.zeros((sampling.window // 2 + 1, signals, signals), dtype=np.complex128)
    triangle = Triangle(np.zeros((sampling.columns,) * 2), 0, none, 0)
    try:
        report, segments = segments_of(log, recipe, channel, sampling.dt_s)
        reason = report.reason or ("" if segments else "no stretch is long enough")
        if segments:
            triangle = triangle_of(segments, sampling)
    except (RecipeError, DataError) as error:
        reason = error.message
    facts = log.facts
    whose = (vehicle_of(facts.info), facts.info.get("firmware", ""), facts.start_utc_ns)
    return FlightPart(log.name, *whose, triangle), reason


def _sampling(
    lake: Lake, recipe: Recipe, channel: str, store: TriangleStore, rate_hz: float | None
) -> Sampling | Unfit:
    """The channel's grid: as it is kept, else from a few flights; chosen again where the fleet has grown."""
    kept = store.sampling(channel)
    if isinstance(kept, Sampling) or (kept is not None and kept.flights == len(lake)):
        return kept
    pilots = spread([facts.id for facts in lake.facts], PILOTS)
    found: Sampling | Unfit
    try:
        found = choose_sampling(align(lake.only(pilots).logs, recipe, channel).dataset, rate_hz)
    except FlysidError as error:
        found = Unfit(error.message, len(lake))
    store.keep_sampling(channel, found)
    return found
