"""What reading logs lost, in words on stderr."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flysid.cli.output import NAMES_SHOWN, note_losses, say
from flysid.facts.losses import lines_of_flights, loss_lines, repeat_lines
from flysid.showing import counted, first_of

if TYPE_CHECKING:
    from flysid.catalogue import FlightFacts
    from flysid.flight import Damage
    from flysid.ingest.lake.batch import Result


def report(results: Sequence[Result], quiet: bool) -> None:
    """Losses and skipped logs by name (even when quiet), then the sums."""
    for result in results:
        say_damage(result.path, result.damage)
    say_skipped([(result.path, result.reason) for result in results if result.skipped])
    for result in results:
        for line in repeat_lines(result.damage):
            say(f"note: {result.path}: {line}", quiet)
    new = [r.flight for r in results if r.flight and not r.unchanged]
    counts = [f"{counted(len(new), 'log')} ingested, {counted(sum(f.rows for f in new), 'record')}"]
    if unchanged := sum(r.unchanged for r in results):
        counts.append(f"{unchanged} unchanged")
    if skipped := sum(r.skipped for r in results):
        counts.append(f"{skipped} skipped")
    say(", ".join(counts), quiet)


def say_damage(path: str | Path, damage: Damage) -> None:
    """What was lost of a log that this call read; what its file lost shows in the exit code."""
    for line in loss_lines(damage):
        say(f"lost: {path}: {line}")
    if damage.lossy:
        note_losses()


def say_lost(flights: Iterable[FlightFacts]) -> None:
    """Name the flights whose logs lack something, as it was counted when they were read."""
    for line in lines_of_flights({flight.id: flight.lacks for flight in flights}, NAMES_SHOWN):
        say(f"lost: {line}")


def say_skipped(skipped: Sequence[tuple[str | Path, str]]) -> None:
    """Name what was skipped and why; many files that are skipped for one kind of reason share a line.

    What was skipped shows in the exit code.
    """
    if skipped:
        note_losses()
    kinds: dict[str, list[tuple[str | Path, str]]] = {}
    for path, reason in skipped:
        kinds.setdefault(reason.partition(":")[0].partition(";")[0], []).append((path, reason))
    for alike in kinds.values():
        if len(alike) <= NAMES_SHOWN:
            for path, reason in alike:
                say(f"skipped: {path}: {reason}")
        else:
            names = first_of([str(path) for path, _ in alike], NAMES_SHOWN)
            say(f"skipped: {counted(len(alike), 'file')}: {names}: {_shared(alike[0][1], alike)}")


def _shared(reason: str, alike: Sequence[tuple[str | Path, str]]) -> str:
    """The reason of files that are skipped for one kind of reason: without what is of the first one only."""
    if all(other == reason for _, other in alike):
        return reason
    what, mark, hint = reason.partition("; try: ")
    return what.partition(":")[0] + mark + hint
