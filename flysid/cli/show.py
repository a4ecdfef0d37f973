"""`flysid show LOG|DATA [FLIGHT] [STREAM]`: a flight or stream; its parameters, messages, events, track."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli import complete
from flysid.cli.addresses import SOURCE
from flysid.cli.bounds import COUNT
from flysid.cli.checks import Reading
from flysid.cli.display import Display
from flysid.cli.output import align_columns, say
from flysid.cli.source import opened_flights, reading_options
from flysid.errors import StoreError, UsageError
from flysid.escaping import one_line
from flysid.facts.clock import log_clock
from flysid.facts.losses import loss_lines, repeat_lines
from flysid.flight import BOOT, RECEIVED, TIME
from flysid.showing import clock, counted

if TYPE_CHECKING:
    from flysid.flight import ClockMap
    from flysid.ingest.lake.lake import StoredLog
    from flysid.ingest.lake.ranges import Range
    from flysid.manifest import Manifest, StreamEntry

STATISTICS = ("MIN", "MEAN", "MAX", "MISSING")
UNKNOWN_FLOWN = "unknown: the log states neither arming nor landing"
HEADINGS = ("COLUMN", "TYPE", "UNIT", "SCALE", *STATISTICS, "VALUES")


@click.command("show")
@click.argument("source", type=SOURCE, metavar="LOG|DATA")
@click.argument("names", nargs=-1, metavar="[FLIGHT] [STREAM]", shell_complete=complete.flights)
@click.option("--json", "as_json", is_flag=True, help="Print the manifest (or the stream's entry) as JSON.")
@click.option(
    "-n", "--rows", default=5, type=COUNT, show_default=True, help="Number of rows of the stream to print."
)
@click.option("--fields", is_flag=True, help="Print unit, range, mean and missing values of all fields.")
@click.option("--params", is_flag=True, help="Print the parameters at the end of the log.")
@click.option("--messages", is_flag=True, help="Print the text messages, in order.")
@click.option("--events", is_flag=True, help="Print modes, messages and parameter changes, in order.")
@click.option("--track", is_flag=True, help="Print the positions as CSV.")
@reading_options
def command(
    source: Path,
    names: tuple[str, ...],
    as_json: bool,
    rows: int,
    fields: bool,
    params: bool,
    messages: bool,
    events: bool,
    track: bool,
    reading: Reading,
) -> None:
    """Show one flight, or one stream of it: columns with units and ranges, rates, losses.

    FLIGHT may be the beginning of an id. It is not needed for a log, nor for a folder with a single flight.
    """
    from flysid.ingest.lake.chosen_flights import Selection, select

    if fields + params + messages + events + track > 1:
        raise UsageError(
            "--fields, --params, --messages, --events and --track are mutually exclusive",
            hint="run the command once for each",
        )
    check_count(names)
    with Display().shown(), opened_flights(source, reading) as lake:
        flight, stream = _split(str(source), names, [facts.id for facts in lake.facts])
        [log] = select(lake, Selection(flights=(flight,))).logs
        if fields:
            _print_fields(log)
        elif params:
            _print_parameters(log)
        elif messages:
            _print_events(log, ("message",))
        elif events:
            _print_events(log, ("mode", "message", "parameter"))
        elif track:
            _print_track(log)
        elif stream is None:
            click.echo(
                flight_json(log.manifest)
                if as_json
                else flight_text(log.manifest, mode_times(log), flown_words(log))
            )
            if as_json:
                return
            if len(log.manifest.streams) == 1:
                click.echo("\n" + stream_text(log, log.manifest.streams[0], rows))
            else:
                say("more: --fields lists all fields with unit and range; STREAM shows the first rows of one")
        else:
            entry = log.manifest.stream(stream)
            click.echo(stream_json(entry) if as_json else stream_text(log, entry, rows))


def check_count(names: Sequence[str]) -> None:
    """Raise UsageError where there are more names than a flight's and a stream's."""
    if len(names) > 2:
        raise UsageError(
            f"{len(names)} names are too many", hint="flysid show LOG [STREAM], or DATA FLIGHT [STREAM]"
        )


def _split(source: str, names: Sequence[str], flights: Sequence[str]) -> tuple[str, str | None]:
    """The flight and the stream that are meant: one name is the stream's where there is one flight."""
    if len(names) == 2:
        return names[0], names[1]
    if len(names) == 1 and not (len(flights) == 1 and not flights[0].startswith(names[0])):
        return names[0], None
    return only_flight(source, flights), names[0] if names else None


def mode_times(log: StoredLog) -> list[str]:
    """The flight modes in the order in which they were first flown, each with its time.

    Nothing where the tables are damaged or gone: the rest of a flight is shown from its manifest.
    """
    from flysid.ingest.lake.events import mode_changes

    try:
        changes = mode_changes(log)
    except StoreError:
        return []
    ends = {clock.boot: clock.last_ns for clock in log.manifest.clocks}
    flown: dict[str, float] = {}
    for i, change in enumerate(changes):
        after = changes[i + 1] if i + 1 < len(changes) else None
        lasts = after is not None and after.boot == change.boot
        end_ns = after.time_ns if after and lasts else ends.get(change.boot, change.time_ns)
        flown[change.text] = flown.get(change.text, 0.0) + max(0, end_ns - change.time_ns) * 1e-9
    return [f"{name} {clock(seconds, padded=True)}" for name, seconds in flown.items()]


def flown_words(log: StoredLog) -> str:
    """How long the vehicle was in the air; "" where the tables are damaged or gone."""
    from flysid.ingest.lake.flown import flown_of

    try:
        seconds = flown_of(log).seconds
    except StoreError:
        return ""
    return UNKNOWN_FLOWN if seconds is None else clock(seconds, padded=True)


def _print_fields(log: StoredLog) -> None:
    """Every field below its stream, but for the columns that the reader adds to all of them."""
    from flysid.ingest.lake.ranges import column_ranges

    rows: list[Sequence[str]] = [("  FIELD", "UNIT", *STATISTICS)]
    counts = []
    for entry in log.manifest.streams:
        fields = [c for c in entry.columns if c.name not in (TIME, BOOT, RECEIVED)]
        ranges = column_ranges(log.table(entry.stream, [c.name for c in fields]))
        counts.append(len(fields))
        rows += [(f"  {c.name}", c.unit, *statistics(ranges[c.name])) for c in fields]
    heading, *lines = align_columns(rows)
    click.echo(heading)
    for entry, count in zip(log.manifest.streams, counts, strict=True):
        click.echo("\n".join([stream_title(entry), *lines[:count]]))
        del lines[:count]


def _print_parameters(log: StoredLog) -> None:
    from flysid.ingest.lake.events import settings, written

    last = {setting.name: setting.value for setting in settings(log)}
    if not last:
        say("the log holds no parameters")
    for name in sorted(last):
        click.echo(one_line(f"{name} {written(last[name])}"))


def _print_events(log: StoredLog, kinds: Sequence[str]) -> None:
    from flysid.ingest.lake.events import events

    clock = log_clock(log.clocks)
    rows = [
        (f"{clock.seconds(e.boot, e.time_ns):.3f} s", e.kind, e.text) for e in events(log) if e.kind in kinds
    ]
    if rows:
        click.echo("\n".join(align_columns(rows)))
        say(f"times: {clock.words}")
    else:
        say(f"the log holds none of these: {', '.join(kinds)}")


def _print_track(log: StoredLog) -> None:
    from pyarrow import csv

    from flysid.ingest.lake.flight_export import inert
    from flysid.ingest.lake.track import read_track

    track = read_track(log)
    if track is None:
        say("the log holds no positions")
    else:
        text = io.BytesIO()
        csv.write_csv(inert(track), text)
        click.echo(text.getvalue().decode(), nl=False)
        say(f"time_s: {log_clock(log.clocks).words}")


def only_flight(data: str, flights: Sequence[str]) -> str:
    """The flight of a folder that holds one; raises UsageError that names those it holds otherwise."""
    if len(flights) == 1:
        return flights[0]
    if not flights:
        raise UsageError("the folder holds no flights", path=data, hint=f"flysid ingest LOG... -o {data}")
    some = ", ".join(flights[:3]) + (", ..." if len(flights) > 3 else "")
    raise UsageError(f"the folder holds {len(flights)} flights", path=data, hint=f"name one: {some}")


def flight_json(manifest: Manifest) -> str:
    """The manifest as it is stored, indented."""

    from flysid.manifest import to_json

    return json.dumps(json.loads(to_json(manifest)), indent=1)


def stream_json(entry: StreamEntry) -> str:
    """One entry of the manifest."""
    import msgspec

    return json.dumps(msgspec.to_builtins(entry), indent=1)


def flight_text(manifest: Manifest, modes: Sequence[str] = (), flown: str = "") -> str:
    """Source, facts, losses and streams of a flight."""
    source = manifest.source
    facts = [
        ("flight", manifest.id),
        ("log", f"{source.name} ({source.format}, {counted(source.size_bytes, 'byte')})"),
        ("sha256", source.sha256),
        ("duration", f"{clock(manifest.duration_s, padded=True)} in {counted(len(manifest.clocks), 'boot')}"),
    ]
    facts += [("date", when) for when in dates(manifest.clocks)]
    facts += [("times", log_clock(manifest.clocks).words)]
    facts += [("flown", flown)] if flown else []
    facts += [("modes", ", ".join(modes))] if modes else []
    facts += [(k, v) for k, v in sorted(manifest.info.items()) if v]
    facts += [("lost", line) for line in loss_lines(manifest.damage)]
    facts += [("repeats", line) for line in repeat_lines(manifest.damage)]
    rows = [("STREAM", "ROWS", "RATE", "COLUMNS", "TIME FROM")]
    rows += [
        (
            s.stream,
            f"{s.rows:,}",
            stream_rate(s),
            str(len(s.columns)),
            s.metadata.get("time_source", ""),
        )
        for s in manifest.streams
    ]
    return "\n".join([*align_columns(facts), "", *align_columns(rows)])


def stream_title(entry: StreamEntry) -> str:
    """A stream's name, rows and rate."""
    rate = stream_rate(entry)
    return f"{one_line(entry.stream)}: {counted(entry.rows, 'row')}" + ("" if rate == "-" else f", {rate}")


def stream_rate(entry: StreamEntry) -> str:
    """A stream's rate; none where two rows make a single interval, or times only keep the order."""
    ordered = entry.metadata.get("time_source") == "order-mapped"
    return "-" if entry.rows < 3 or ordered else rate_text(entry.rate_hz)


def rate_text(rate_hz: float | None) -> str:
    """A rate for people."""
    if rate_hz is None:
        return "-"
    if rate_hz < 0.05:
        return "< 0.1 Hz"
    return f"{rate_hz:.1f} Hz" if rate_hz < 100 else f"{rate_hz:.0f} Hz"


def dates(clocks: Sequence[ClockMap]) -> list[str]:
    """When the boots began that the log ties to UTC."""
    return [
        f"{datetime.fromtimestamp(c.began_utc_ns / 1e9, UTC):%Y-%m-%d %H:%M:%S} UTC"
        for c in clocks
        if c.began_utc_ns is not None
    ]


def statistics(found: Range) -> list[str]:
    """The cells of `STATISTICS`; empty where there is no number, or nothing is missing."""
    numbers = ["" if x is None else f"{x + 0.0:.6g}" for x in (found.low, found.mean, found.high)]
    return [*numbers, f"{found.missing:,}" if found.missing else ""]


def stream_text(log: StoredLog, entry: StreamEntry, count: int) -> str:
    """Columns of a stream with units and ranges, and its first rows."""
    from flysid.ingest.lake.ranges import column_ranges

    table = log.table(entry.stream, [c.name for c in entry.columns])
    ranges = column_ranges(table)
    columns: list[tuple[str, ...]] = [HEADINGS]
    for c in entry.columns:
        names = ", ".join([*(f"{k}={v}" for k, v in list(c.enum.items())[:3]), *["..."][: len(c.enum) > 3]])
        scale = "" if c.scale == 1.0 else f"{c.scale:g}"
        kind = re.sub(r"fixed_size_list<item: (\w+)>", r"\1", c.type)
        columns.append((c.name, kind, c.unit, scale, *statistics(ranges[c.name]), names))
    first = [tuple(c.name for c in entry.columns)]
    first += [tuple(cell(value) for value in row.values()) for row in table.slice(0, count).to_pylist()]
    return "\n".join([stream_title(entry), "", *align_columns(columns), "", *align_columns(first)])


def cell(value: object) -> str:
    """A value as a row shows it: numbers rounded, whatever is long cut."""
    if isinstance(value, list):
        value = f"[{', '.join(f'{x:.4g}' if isinstance(x, float) else str(x) for x in value)}]"
    return f"{value:.9g}" if isinstance(value, float) else str(value)[:24]
