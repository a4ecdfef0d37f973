"""`flysid ingest LOG... -o data`: logs into typed parquet tables."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.bounds import bounds_options
from flysid.cli.checks import Reading
from flysid.cli.display import Display, progress_options
from flysid.cli.lakeoptions import LakeOptions, check_pattern, lake_options
from flysid.cli.losses import report
from flysid.cli.options import jobs_option
from flysid.cli.output import say, say_passed_over
from flysid.cli.source import reading_options
from flysid.cli.trust import Own
from flysid.escaping import one_line
from flysid.showing import counted

if TYPE_CHECKING:
    from flysid.ingest.lake.batch import Result
    from flysid.ingest.lake.workers import Bounds


@click.command("ingest")
@click.argument("logs", nargs=-1, required=True, metavar="LOG...")
@click.option(
    "-o", "--output", "data", cls=Own, default="data", show_default=True, help="The folder to fill."
)
@jobs_option("Worker processes; one per core when not given.")
@bounds_options
@reading_options
@click.option(
    "--vehicle-in",
    cls=Own,
    default="",
    metavar="REGEX",
    help="Pattern of the vehicle's name in a log's path or address, e.g. 'v[0-9]+'.",
)
@lake_options
@click.option("--force", cls=Own, is_flag=True, help="Read logs again even if they are unchanged.")
@click.option("--json", "as_json", is_flag=True, help="Print the result for every log as JSON.")
@progress_options
def command(
    logs: tuple[str, ...],
    data: str,
    jobs: int,
    bounds: Bounds,
    reading: Reading,
    vehicle_in: str,
    lake: LakeOptions,
    force: bool,
    as_json: bool,
    display: Display,
) -> int:
    """Read flight logs (files, folders, patterns) into typed parquet tables, one per message.

    Logs that are already ingested are skipped. Prints the id of each flight that was ingested. Exit code 3:
    something was lost or skipped; the output says what and where. A log that exceeds its limit of memory or
    time is skipped and named; the others are read. In folders and .zip archives, files that are not logs,
    such as notes and pictures, are named and ignored.

    With --format, --time-unit or --date-order, logs that are already ingested are read again, as their data
    may change.

    LOG and the folder may be addresses: s3://BUCKET/FOLDER, gs://, az:// (flysid[fleet]). Logs that the
    lake already has are not fetched again. Exit code 75: a store or a cluster did not answer; run the
    command again.
    """
    check_pattern(vehicle_in)
    from flysid.ingest.lake.batch import ingest_logs
    from flysid.ingest.lake.finding import find_logs

    limits = reading.limits
    if lake.concerns(logs, data):
        from flysid.cli.lakeingest import ingest_to_lake

        return ingest_to_lake(logs, data, lake, limits, bounds, vehicle_in, jobs, force, as_json, display)
    found = find_logs(logs, bounds)
    results = []
    with display.shown():
        again = force or reading != Reading()
        for result in ingest_logs(
            found, data, jobs=jobs, force=again, limits=limits, bounds=bounds, vehicle_in=vehicle_in
        ):
            results.append(result)
            said_below = result.unchanged or result.skipped
            say(describe(result), display.quiet or said_below or display.live)
    results.sort(key=lambda r: str(r.path))
    if as_json:
        passed = [{"path": str(item.path), "kind": item.kind} for item in found.passed_over]
        document = {"data": data, "logs": [as_document(r) for r in results], "passed_over": passed}
        click.echo(json.dumps(document, indent=1))
    else:
        for result in results:
            if result.flight and not result.unchanged:
                click.echo(one_line(result.flight.id))
    say_passed_over(found.passed_over, display.quiet)
    report(results, display.quiet)
    return 1 if all(result.skipped for result in results) else 0


def describe(result: Result) -> str:
    """What became of one log, in one line."""
    from flysid.ingest.formats.opening import short_name

    name = short_name(result.path)
    if result.flight is None:
        return f"{name}: skipped: {result.reason}"
    if result.unchanged:
        return f"{name}: unchanged"
    flight = result.flight
    return (
        f"{name}: {flight.format}, {counted(flight.rows, 'record')} in "
        f"{counted(len(flight.streams), 'stream')}, {flight.duration_s:.1f} s"
    )


def as_document(result: Result) -> dict[str, Any]:
    """One log for `--json`."""
    document: dict[str, Any] = {"path": str(result.path)}
    if result.flight is None:
        return {**document, "status": "skipped", "reason": result.reason}
    import msgspec

    flight = result.flight
    document |= {
        "status": "unchanged" if result.unchanged else "ingested",
        "id": flight.id,
        "format": flight.format,
        "records": flight.rows,
        "streams": len(flight.streams),
        "duration_s": flight.duration_s,
        "lossy": flight.lossy,
        "losses": flight.losses,
    }
    return document if result.unchanged else {**document, "damage": msgspec.to_builtins(result.damage)}
