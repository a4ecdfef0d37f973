"""`flysid doctor --kinematics`: whether a log's instruments agree, and a recipe that corrects them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flysid.cli.display import Display
from flysid.cli.output import say
from flysid.errors import FlysidError, UsageError
from flysid.escaping import one_line

if TYPE_CHECKING:
    from flysid.ingest.formats.base import Limits
    from flysid.ingest.kinematics.compatibility import Compatibility
    from flysid.ingest.lake.workers import Bounds


@dataclass(frozen=True)
class Motion:
    """What was found of one log, or why nothing was."""

    found: Compatibility | None = None
    reason: str = ""

    def lines(self, path: Path) -> list[str]:
        """For people."""
        from flysid.ingest.formats.opening import short_name
        from flysid.ingest.kinematics.telling import lines, nothing_to_compare

        name = short_name(path)
        if self.found is None:
            return [one_line(f"kinematics of {name}: {self.reason}")]
        if nothing := nothing_to_compare(self.found):
            return [one_line(f"kinematics of {name}: {nothing}")]
        return [one_line(line) for line in (f"kinematics of {name}", *(f"  {w}" for w in lines(self.found)))]

    def as_document(self) -> dict[str, Any]:
        """For `--json`."""
        if self.found is None:
            return {"kinematics": {"reason": self.reason}} if self.reason else {}
        from flysid.ingest.kinematics.telling import as_document

        return {"kinematics": as_document(self.found)}


def compatibility_or_reason(path: Path, limits: Limits) -> Compatibility | str:
    """One log's compatibility, or why it cannot be had: a task for a worker process."""
    from flysid.ingest.align.signals import FlightLog
    from flysid.ingest.formats.registry import read
    from flysid.ingest.kinematics.compatibility import compatibility

    try:
        flight = read(path, limits=limits)
        return compatibility(FlightLog(flight))
    except FlysidError as error:
        return error.advice
    except MemoryError:
        return "not enough memory"


def motions(paths: Sequence[Path], limits: Limits, bounds: Bounds, display: Display) -> Mapping[Path, Motion]:
    """The kinematics of every log."""
    from flysid.ingest.lake.workers import Lost, read_bounded

    found: dict[Path, Motion] = {}
    with display.shown():
        for path, outcome in read_bounded(
            partial(compatibility_or_reason, limits=limits), list(paths), 1, bounds
        ):
            if isinstance(outcome, Lost):
                found[path] = Motion(reason=outcome.reason)
            elif isinstance(outcome, str):
                found[path] = Motion(reason=outcome)
            else:
                found[path] = Motion(outcome)
    return found


def check_one_log(count: int) -> None:
    """Raise UsageError where a recipe would be corrected by several logs, or by none."""
    if count != 1:
        raise UsageError(f"--correct takes one log, not {count}", hint="every flight has its own biases")


def write_corrected(
    moved: Mapping[Path, Motion], recipe: str, output: Path, limits: Limits, quiet: bool
) -> None:
    """Write a recipe with what was found of one log taken out of its signals."""
    from flysid.files import write_atomically, writing_to
    from flysid.ingest.align.signals import FlightLog
    from flysid.ingest.formats.registry import read
    from flysid.ingest.kinematics.telling import corrected_recipe

    check_one_log(len(moved))
    ((path, motion),) = moved.items()
    if motion.found is None:
        raise UsageError(f"nothing to correct: {motion.reason}")
    flight = read(path, limits=limits)
    text, done = corrected_recipe(recipe, FlightLog(flight), motion.found)
    with writing_to(output):
        write_atomically(output, text.encode())
    for line in done:
        say(f"corrected: {line}", quiet)
    say(f"written: {output}", quiet)
