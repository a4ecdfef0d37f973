"""`flysid ingest` where logs, or the folder to fill, are at an address."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.display import Display
from flysid.cli.lakeoptions import LakeOptions, dask_cluster
from flysid.cli.output import ExitCode, cores, say
from flysid.errors import FlysidError, PlaceError, UsageError
from flysid.escaping import one_line
from flysid.showing import counted, duration, first_of

if TYPE_CHECKING:
    from flysid.fleet.ingest_many import Engine, Sorted
    from flysid.fleet.reading import LogOutcome, Settings
    from flysid.ingest.formats.base import Limits
    from flysid.ingest.lake.workers import Bounds

SHOWN = 5


def ingest_to_lake(
    logs: Sequence[str],
    data: str,
    options: LakeOptions,
    limits: Limits,
    bounds: Bounds,
    vehicle_in: str,
    jobs: int,
    force: bool,
    as_json: bool,
    display: Display,
) -> int:
    """Ingest once, or again and again; the exit code."""
    from flysid.fleet.reading import Settings
    from flysid.place import is_address

    if not is_address(data):
        raise UsageError(
            "logs at an address go into a lake at an address",
            path=data,
            hint="-o s3://BUCKET/LAKE; or copy the logs here and ingest the copies",
        )
    again = force or limits != type(limits)()
    settings = Settings(data.rstrip("/"), limits, bounds, vehicle_in, again)

    def once(engine: Engine) -> int:
        found = found_logs(logs, settings, options, again)
        outcomes = done(found, settings, engine, options, display)
        if as_json:
            click.echo(json.dumps(as_document(data, found, outcomes), indent=1))
        else:
            for outcome in outcomes:
                if outcome.status == "ingested" and outcome.facts:
                    click.echo(one_line(outcome.facts.id))
        summarise(found, outcomes, display.quiet)
        return exit_code(outcomes, found)

    with engine_for(options, jobs, display.quiet) as engine:
        if options.watch_s is None:
            return once(engine)
        while True:
            try:
                once(engine)
            except PlaceError as error:
                say(f"{error.message}; trying again in {duration(options.watch_s)}")
            say(f"next look in {duration(options.watch_s)}", display.quiet)
            time.sleep(options.watch_s)


def found_logs(logs: Sequence[str], settings: Settings, options: LakeOptions, force: bool) -> Sorted:
    """The logs to read."""
    from flysid.fleet.ingest_many import find
    from flysid.fleet.lakes import create_lake

    create_lake(settings.lake)
    return find(logs, settings.lake, options.since, options.retry, force, settings.bounds)


def done(
    found: Sorted,
    settings: Any,
    engine: Engine,
    options: LakeOptions,
    display: Display,
) -> list[LogOutcome]:
    """What became of every log that was read, by address."""
    from flysid.fleet.ingest_many import ingest

    outcomes: list[LogOutcome] = []
    with display.shown():
        for outcome in ingest(found, settings, engine, options.batch):
            outcomes.append(outcome)
            say(describe(outcome), display.quiet or display.live or outcome.status == "unchanged")
    return sorted(outcomes, key=lambda outcome: outcome.log.url)


@contextmanager
def engine_for(options: LakeOptions, jobs: int, quiet: bool) -> Iterator[Engine]:
    """Threads here; a Dask cluster where one is requested."""
    if not options.cluster and not options.workers:
        from flysid.fleet.ingest_many import Threads

        yield Threads(jobs or cores())
        return
    with dask_cluster(options.cluster, options.workers, quiet) as cluster:
        yield cluster


def describe(outcome: LogOutcome) -> str:
    """What became of one log, in one line."""
    facts = outcome.facts
    if outcome.status == "ingested" and facts is not None:
        return (
            f"{outcome.log.name}: {facts.format}, {counted(facts.rows, 'record')} in "
            f"{counted(len(facts.streams), 'stream')}, {facts.duration_s:.1f} s"
        )
    said = {
        "quarantined": "in quarantine: ",
        "duplicate": "a duplicate of ",
        "waiting": "not done: ",
        "ignored": "ignored: ",
    }
    return f"{outcome.log.name}: {said.get(outcome.status, outcome.status)}{outcome.reason}"


def summarise(found: Sorted, outcomes: Sequence[LogOutcome], quiet: bool) -> None:
    """How many of what, and what to do about it; what went wrong even where it shall be quiet."""
    many = Counter(outcome.status for outcome in outcomes)
    many["unchanged"] += found.known
    words = {
        "ingested": "ingested",
        "unchanged": "there already",
        "duplicate": "already there under another name",
        "quarantined": "in quarantine",
        "waiting": "not done",
        "ignored": "ignored",
    }
    told = ", ".join(f"{many[status]:,} {word}" for status, word in words.items() if many[status])
    say(told or "no logs", quiet)
    if found.quarantined:
        say(f"{counted(found.quarantined, 'log')} in quarantine since before: --retry reads them", quiet)
    if found.passed_over:
        names = [name.rpartition("/")[2] for name in found.passed_over]
        say(f"ignored, not logs: {first_of(names, SHOWN)}", quiet)
    for url, reason in found.unread:
        say(f"skipped: {url}: {reason}")
    lossy = sum(o.status == "ingested" and o.facts is not None and o.facts.lossy for o in outcomes)
    if lossy:
        say(f"{counted(lossy, 'log')} lost something; details: flysid show LAKE FLIGHT", quiet)
    if many["waiting"]:
        reasons = Counter(outcome.reason for outcome in outcomes if outcome.status == "waiting")
        say(f"not done: {reasons.most_common(1)[0][0]}; run the same command again")


def exit_code(outcomes: Sequence[LogOutcome], found: Sorted) -> int:
    """75 where a log waits, 1 where none could be read, 3 where one cannot, or lost something, else 0."""
    if any(outcome.status == "waiting" for outcome in outcomes):
        return PlaceError.exit_code
    refused = sum(outcome.status == "quarantined" for outcome in outcomes)
    bad = refused + len(found.unread)
    if bad and refused == len(outcomes) and not found.known:
        return FlysidError.exit_code
    lossy = any(o.status == "ingested" and o.facts is not None and o.facts.lossy for o in outcomes)
    return ExitCode.LOSSES if bad or lossy else 0


def as_document(data: str, found: Sorted, outcomes: Sequence[LogOutcome]) -> dict[str, Any]:
    """The whole ingest for `--json`."""
    return {
        "data": data,
        "logs": [
            {
                "url": outcome.log.url,
                "status": outcome.status,
                **({"id": outcome.facts.id} if outcome.facts else {}),
                **({"reason": outcome.reason} if outcome.reason else {}),
            }
            for outcome in outcomes
        ],
        "known": found.known,
        "in_quarantine": found.quarantined,
        "passed_over": list(found.passed_over),
        "unread": [{"url": url, "reason": reason} for url, reason in found.unread],
    }
