"""`flysid doctor LOG...`: one line per log."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flysid.cli import complete
from flysid.cli.bounds import bounds_options
from flysid.cli.checks import Reading
from flysid.cli.display import Display, progress_options
from flysid.cli.kinematics import Motion, check_one_log, motions, write_corrected
from flysid.cli.losses import say_skipped
from flysid.cli.output import (
    NAMES_SHOWN,
    REASONS_SHOWN,
    align_columns,
    check_target,
    note_losses,
    say,
    say_passed_over,
    shorten,
)
from flysid.cli.source import reading_options
from flysid.cli.trust import Own
from flysid.errors import FlysidError, UsageError
from flysid.escaping import one_line
from flysid.facts.losses import lost_words, repeat_lines
from flysid.progress import tell
from flysid.showing import WIDTH, clock, counted, first_of, fold

if TYPE_CHECKING:
    from flysid.ingest.formats.base import Limits
    from flysid.ingest.lake.survey import Survey
    from flysid.ingest.lake.workers import Bounds

HEADINGS = ("VEHICLE", "FIRMWARE", "TIME", "ATT", "CMD", "VEL", "MOVED", "LOST", "VERDICT")
ROLES_SHOWN = {"ATT": "attitude", "CMD": "command", "VEL": "velocity"}
CORRECTED = Path("corrected.toml")
NOTHING = {"-", "?"}
SHORTEST_NAME = 12
VEHICLE_RECIPE = "sixdof"
MOTOR = "motor"


@click.command("doctor")
@click.argument("logs", nargs=-1, required=True, metavar="LOG...")
@bounds_options
@reading_options
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option(
    "--kinematics",
    is_flag=True,
    help="Compare attitude, gyro, accelerometer, velocity and position: biases, scales, lags, lever arm.",
)
@click.option(
    "--correct",
    cls=Own,
    default="",
    metavar="RECIPE",
    shell_complete=complete.recipes,
    help="With --kinematics, for one log: write this recipe with its signals corrected for the findings.",
)
@click.option(
    "--output",
    "-o",
    type=click.Path(path_type=Path),
    help="File of the corrected recipe.  [default: corrected.toml]",
)
@progress_options
def command(
    logs: tuple[str, ...],
    bounds: Bounds,
    reading: Reading,
    as_json: bool,
    kinematics: bool,
    correct: str,
    output: Path | None,
    display: Display,
) -> int:
    """Check every log: its contents, its losses, and what to log next time.

    Which channels are worth a fit, and around which a loop is closed, flysid ls DATA --suggest tells.

    Exit code 3: data was lost, or a log could not be read; 1: no log could be read.
    """
    from flysid.cli.addresses import here
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.formats.opening import short_name
    from flysid.ingest.lake.finding import find_logs
    from flysid.ingest.lake.survey import survey_or_reason
    from flysid.ingest.lake.workers import Lost, read_bounded
    from flysid.place import is_address

    if (correct or output) and not kinematics:
        raise UsageError("--correct and -o belong to --kinematics", hint="flysid doctor LOG --kinematics")
    if correct:
        load_recipe(correct)
        check_target(output or CORRECTED, force=True, makes_folders=False)
    found = find_logs([here(log) if is_address(log) else log for log in logs], bounds)
    if correct:
        check_one_log(len(found.paths))
    skipped = [(unread.path, unread.reason) for unread in found.unread]
    surveys: dict[Path, Survey] = {}
    limits = reading.limits
    look = partial(survey_or_reason, limits=limits)
    with display.shown():
        _begin(found.paths, 0)
        for done, (path, outcome) in enumerate(read_bounded(look, found.paths, 1, bounds), 1):
            if isinstance(outcome, (str, Lost)):
                skipped.append((path, outcome if isinstance(outcome, str) else outcome.reason))
            else:
                surveys[path] = outcome
            _begin(found.paths, done)
        telemetered = telemetry(surveys, limits, bounds)
    say_skipped(skipped)
    moved = motions(list(surveys), limits, bounds, display) if kinematics else {}
    if as_json:
        shown = [
            as_document(path, s)
            | {"telemetry": list(telemetered.get(path, ()))}
            | moved.get(path, Motion()).as_document()
            for path, s in surveys.items()
        ]
        click.echo(json.dumps({"logs": shown}, indent=1))
    elif surveys:
        click.echo("\n".join(lines(surveys, telemetered)))
    if moved and not as_json:
        click.echo("\n".join(line for path, motion in moved.items() for line in motion.lines(path)))
    if correct:
        write_corrected(moved, correct, output or CORRECTED, limits, display.quiet)
    for path, survey in surveys.items():
        if "clock_note" in survey.info:
            say(f"note: {short_name(path)}: {survey.info['clock_note']}", display.quiet)
        for stream, why in list(survey.damage.reasons.items())[:REASONS_SHOWN]:
            say(f"lost: {short_name(path)}: {stream}: {why}")
        if survey.damage.lossy:
            note_losses()
    say_passed_over(found.passed_over, display.quiet)
    say(
        f"{counted(len(surveys), 'log')} examined" + (f", {len(skipped)} skipped" if skipped else ""),
        display.quiet,
    )
    return 0 if surveys else 1


def _begin(logs: Sequence[Path], done: int) -> None:
    """Tell which log is looked at next: one at a time, in their order."""
    if done < len(logs):
        tell("examining", log=logs[done].name, share=done / len(logs))


def lines(
    surveys: Mapping[Path, Survey], telemetered: Mapping[Path, Sequence[str]] | None = None
) -> Iterator[str]:
    """A row for every log, and below them what there is to say of some: each thing once.

    `telemetered`: what is wrong with the telemetry of a log's motors and instruments, in words.
    """
    from flysid.ingest.formats.opening import short_name

    columns = list(zip(HEADINGS, *map(row, surveys.values()), strict=True))
    columns = [column for column in columns if not NOTHING.issuperset(column[1:])]
    names = [short_name(path) for path in surveys]
    room = WIDTH - sum(2 + max(map(len, column)) for column in columns)
    shown = [shorten(name, max(room, SHORTEST_NAME)) for name in names]
    yield from align_columns(list(zip(("FILE", *shown), *columns, strict=True)))
    rates = {column[0]: ROLES_SHOWN[column[0]] for column in columns if column[0] in ROLES_SHOWN}
    if rates:
        yield f"{', '.join(rates)}: rate of {', '.join(rates.values())} in Hz"
    about: dict[str, list[str]] = {}
    for name, (path, found) in zip(names, surveys.items(), strict=True):
        for remark in [*remarks(found), *(telemetered or {}).get(path, ())]:
            about.setdefault(remark, []).append(name)
    for remark, those in about.items():
        yield fold(one_line(f"{first_of(those, NAMES_SHOWN)}: {remark}"))


def row(found: Survey) -> tuple[str, ...]:
    """One log as the cells of a table, without its name."""
    from flysid.facts.vehicle import label_of
    from flysid.ingest.lake.survey import verdict

    return (
        label_of(found.info),
        found.info.get("firmware") or "-",
        clock(found.duration_s, padded=True),
        *(rate_cell(found.role(role)[1]) for role in ROLES_SHOWN.values()),
        found.excited(),
        "yes" if lost_words(found.damage) else "0",
        verdict(found)[0].partition(": ")[0],
    )


def remarks(found: Survey) -> Iterator[str]:
    """What was lost, what the verdict rests on, and what to try."""
    from flysid.ingest.lake.survey import verdict

    lost = lost_words(found.damage)
    if lost:
        yield f"lost: {lost}"
    yield from repeat_lines(found.damage)
    words, advice = verdict(found)
    short, _, rest = words.partition(": ")
    if rest or advice:
        yield f"{short}: {'; '.join(part for part in (rest, advice) if part)}"


def rate_cell(rate_hz: float) -> str:
    """A rate in Hz, or "-" where nothing is logged."""
    return f"{rate_hz:.0f}" if rate_hz >= 9.5 else f"{rate_hz:.1f}" if rate_hz > 0 else "-"


def as_document(path: Path, found: Survey) -> dict[str, Any]:
    """One log for `--json`."""
    import msgspec

    from flysid.ingest.formats.opening import short_name
    from flysid.ingest.lake.survey import ROLES, verdict

    words, advice = verdict(found)
    return {
        "file": short_name(path),
        "format": found.source.format,
        "size_bytes": found.source.size_bytes,
        "info": dict(found.info),
        "duration_s": found.duration_s,
        "flown_s": found.flown.seconds,
        "usable_s": found.usable_s,
        "rates_hz": {role: dict([found.role(role)]) if found.role(role)[0] else {} for role in ROLES},
        "streams": {key: count.rows for key, count in found.streams.items()},
        "moved": found.excited(),
        "lossy": found.damage.lossy,
        "losses": lost_words(found.damage),
        "damage": msgspec.to_builtins(found.damage),
        "verdict": words,
        "advice": advice,
    }


def telemetry_lines(path: Path, limits: Limits) -> tuple[str, ...]:
    """Of one log, as `flysid vehicle` finds and leaves them out: a task for a worker process."""
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.align.signals import FlightLog
    from flysid.ingest.align.vehicle_channel import vehicle_data
    from flysid.ingest.formats.registry import read
    from flysid.sixdof.records import flights_of

    try:
        data = vehicle_data([FlightLog(read(path, limits=limits))], load_recipe(VEHICLE_RECIPE)).dataset
        return tuple(line for damage in flights_of(data).damage for line in damage.lines)
    except FlysidError:
        return ()  # no motors, no gyro, or nothing flies: then there is nothing to tell
    except MemoryError:
        return ()


def telemetry(
    surveys: Mapping[Path, Survey], limits: Limits, bounds: Bounds
) -> Mapping[Path, tuple[str, ...]]:
    """The lines of every log that holds commands of motors."""
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.lake.workers import read_bounded

    signals = load_recipe(VEHICLE_RECIPE).signals
    streams = tuple(
        {s.stream for name, own in signals.items() if name.startswith(MOTOR) for s in own.sources}
    )
    chosen = [
        path for path, found in surveys.items() if any(key.startswith(streams) for key in found.streams)
    ]
    look = partial(telemetry_lines, limits=limits)
    return {path: lines for path, lines in read_bounded(look, chosen, 1, bounds) if isinstance(lines, tuple)}
