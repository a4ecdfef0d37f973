"""The flights of a lake in an object store, as a Delta table that DuckDB, Polars, pandas and Spark read.

The table is an index, never the truth: `flysid fleet check --repair` makes it again from the manifests. Only
the process that ingests writes it, never its workers; two that ingest at once merge their rows.
"""

from __future__ import annotations

import json
import random
import re
import time
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from functools import partial
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import msgspec
import pyarrow as pa

from flysid.catalogue import FlightFacts
from flysid.errors import PlaceError, UsageError
from flysid.facts.vehicle import vehicle_of
from flysid.manifest import check_id
from flysid.place import Place

TABLE = "catalog/flights"
SCHEMA = pa.schema(
    [
        ("flight", pa.string()),
        ("vehicle", pa.string()),
        ("firmware", pa.string()),
        ("hardware", pa.string()),
        ("start", pa.timestamp("us", "UTC")),
        ("month", pa.string()),
        ("duration_s", pa.float64()),
        ("modes", pa.list_(pa.string())),
        ("streams", pa.list_(pa.string())),
        ("stream_rows", pa.list_(pa.int64())),
        ("rows", pa.int64()),
        ("lost", pa.bool_()),
        ("losses", pa.string()),
        ("log", pa.string()),
        ("format", pa.string()),
        ("size_bytes", pa.int64()),
        ("sha256", pa.string()),
        ("source_url", pa.string()),
        ("source_etag", pa.string()),
        ("generation", pa.string()),
        ("flysid", pa.string()),
        ("layout", pa.string()),
        ("info", pa.string()),
        ("manifest_bytes", pa.int64()),
        ("manifest_digest", pa.int64()),
    ]
)

Answer = TypeVar("Answer")


def rows_of(flights: Iterable[FlightFacts]) -> pa.Table:
    """Flights as rows of the table."""
    return pa.Table.from_pylist([_row(facts) for facts in flights], schema=SCHEMA)


def _row(facts: FlightFacts) -> dict[str, Any]:
    info = facts.info
    start = None
    if facts.start_utc_ns is not None:
        start = datetime.fromtimestamp(facts.start_utc_ns // 1000 / 1e6, UTC)
    return {
        "flight": facts.id,
        "vehicle": vehicle_of(info),
        "firmware": info.get("firmware") or info.get("ver_sw", ""),
        "hardware": info.get("ver_hw") or info.get("board", ""),
        "start": start,
        "month": f"{start:%Y-%m}" if start else "",
        "duration_s": facts.duration_s,
        "modes": [name for name in info.get("modes", "").split(", ") if name],
        "streams": list(facts.streams),
        "stream_rows": list(facts.streams.values()),
        "rows": facts.rows,
        "lost": facts.lost,
        "losses": facts.losses,
        "log": facts.log,
        "format": facts.format,
        "size_bytes": facts.size_bytes,
        "sha256": facts.sha256,
        "source_url": info.get("source_url", ""),
        "source_etag": info.get("source_etag", ""),
        "generation": info.get("generation", ""),
        "flysid": facts.flysid,
        "layout": facts.layout,
        "info": json.dumps(dict(info), sort_keys=True),
        "manifest_bytes": facts.stamp[0],
        "manifest_digest": facts.stamp[1],
    }


def facts_in(rows: pa.Table) -> tuple[FlightFacts, ...]:
    """Rows of the table as flights, by id; raises StoreError where an id is none."""
    starts = rows["start"].cast(pa.int64()).to_pylist()  # as dates with a zone they would bring pandas in
    found = [
        FlightFacts(
            id=row["flight"],
            log=row["log"],
            format=row["format"],
            size_bytes=row["size_bytes"],
            sha256=row["sha256"],
            flysid=row["flysid"],
            duration_s=row["duration_s"],
            rows=row["rows"],
            lossy=row["lost"],
            losses=row.get("losses") or "",
            start_utc_ns=None if start is None else start * 1000,
            info=json.loads(row["info"]),
            streams=dict(zip(row["streams"], row["stream_rows"], strict=True)),
            layout=row["layout"],
            stamp=(row["manifest_bytes"], row["manifest_digest"]),
        )
        for row, start in zip(rows.drop_columns("start").to_pylist(), starts, strict=True)
    ]
    for facts in found:
        check_id(facts.id, "the lake's table of flights")
    return tuple(sorted(found, key=lambda facts: facts.id))


# ------------------------------------------------------------------------------------------- asking


def select(place: Place, where: str = "", columns: Sequence[str] = ()) -> pa.Table:
    """Rows of a lake's table for which a condition in SQL holds: `vehicle = 'v017' and rows > 1000`.

    Raises UsageError: the condition is not understood; the message says which columns there are.
    """
    chosen = ", ".join(f'"{name}"' for name in columns) or "*"
    return ask(place, f"select {chosen} from flights" + (f" where {where}" if where else ""))


def ask(place: Place, sql: str) -> pa.Table:
    """What a question in SQL about the table `flights` is answered.

    Raises UsageError: not understood, or more than a question.
    """
    table = open_table(place)
    if table is None:
        with TemporaryDirectory() as folder:
            return ask_table(_made(folder), sql, place.address)
    return ask_table(table, sql, place.address)


def ask_table(table: Any, sql: str, where: str) -> pa.Table:
    """A question about a Delta table; see `ask`. Errors name `where` it is."""
    if not re.match(r"\s*(select|with)\b", sql, re.IGNORECASE):
        raise UsageError("a query begins with SELECT or WITH", hint="select count(*) from flights")
    from deltalake import QueryBuilder

    try:
        query = QueryBuilder().register("flights", table)
        return _asking(where, lambda: pa.RecordBatchReader.from_stream(query.execute(sql)).read_all())
    except PlaceError:
        raise
    except Exception as error:  # DataFusion's own errors have no class in common
        told = str(error).splitlines()[0]
        raise UsageError(
            f"the query failed: {told}", path=where, hint="columns: " + ", ".join(SCHEMA.names)
        ) from error


def open_table(place: Place) -> Any:
    """A lake's table; None where there is none yet."""
    from deltalake import DeltaTable
    from deltalake.exceptions import TableNotFoundError

    try:
        return _asking(place.address, lambda: DeltaTable(place.at(TABLE)))
    except TableNotFoundError:
        return None


class Commit(msgspec.Struct, frozen=True):
    """A commit of a lake's table: its version, and the store's tag of its content."""

    version: int = -1
    etag: str = ""


def last_commit(place: Place, since: int = 0) -> Commit:
    """The newest commit of a lake's table, of this version or a later one; one request, of no table's."""
    log = f"{TABLE}/_delta_log"
    commits = [
        Commit(int(entry[1]), found.etag)
        for found in place.list(log, after=f"{log}/{max(since, 0):020}")
        if (entry := re.fullmatch(rf"{log}/(\d+)\.json", found.key))
    ]
    return max(commits, key=lambda commit: commit.version, default=Commit())


# ------------------------------------------------------------------------------------------- writing


def merge(place: Place, flights: Sequence[FlightFacts]) -> None:
    """Put flights into the table: new ones are added, those that were read again are replaced.

    Raises PlaceError where other writers, or the store, do not let it.
    """
    if flights:
        committing(place, partial(_merge, place, rows_of(flights)))


def _merge(place: Place, rows: pa.Table) -> None:
    from deltalake import CommitProperties

    table = open_table(place)
    if table is None:
        table = _made(place.at(TABLE))
    held = {column.name for column in table.schema().fields}  # a lake of an earlier release has fewer
    rows = rows.select([name for name in rows.column_names if name in held])
    (
        table.merge(
            source=rows,
            predicate="t.sha256 = s.sha256",
            source_alias="s",
            target_alias="t",
            commit_properties=CommitProperties(max_commit_retries=0),
        )
        .when_matched_update_all(predicate="s.manifest_digest <> t.manifest_digest")
        .when_not_matched_insert_all()
        .execute()
    )


def _made(address: str) -> Any:
    from deltalake import DeltaTable

    return DeltaTable.create(address, schema=SCHEMA, mode="ignore")


def rebuild(place: Place, flights: Sequence[FlightFacts]) -> None:
    """The table anew, of these flights."""
    from deltalake import write_deltalake

    committing(place, lambda: write_deltalake(place.at(TABLE), rows_of(flights), mode="overwrite"))


def remove(place: Place, hashes: Sequence[str]) -> None:
    """Take flights out of the table; its history still has them."""
    if (table := open_table(place)) is None:
        return
    listed = ", ".join(f"'{digits}'" for digits in hashes if re.fullmatch("[0-9a-f]+", digits))
    committing(place, lambda: table.delete(f"sha256 in ({listed})"))


def committing(place: Place, write: Callable[[], Answer], *, tries: int = 12) -> Answer:
    """Write, again where another writer was faster. `tries`: of a commit beside other writers."""
    from deltalake.exceptions import CommitFailedError

    for attempt in range(tries):
        try:
            return _asking(place.address, write)
        except CommitFailedError as error:
            last = error
            time.sleep(random.uniform(0.0, min(0.1 * 2**attempt, 5.0)))
    raise PlaceError(
        f"the catalogue could not be written: {str(last).splitlines()[0]}",
        path=place.at(TABLE),
        hint="other writers hold it; the flights are committed: run the same command again",
    )


def _asking(where: str, do: Callable[[], Answer]) -> Answer:
    """Do it; flysid's own words where the store is at fault."""
    try:
        return do()
    except Exception as error:  # whatever deltalake's classes are
        if not re.search("HTTP error|status code: 5|after [0-9]+ retries", str(error)):
            raise
        raise PlaceError(
            "the store did not answer",
            path=where,
            hint="nothing that is committed is lost: run the same command again when it answers",
        ) from None
