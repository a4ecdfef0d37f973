"""What `flysid doctor` tells of telemetry: link losses, impossible commands, a clock that wanders."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from flysid.errors import FlysidError

if TYPE_CHECKING:
    from flysid.ingest.formats.base import Limits
    from flysid.ingest.lake.survey import Survey
    from flysid.ingest.lake.workers import Bounds

RECIPE = "sixdof"
MOTOR = "motor"


def telemetry_lines(path: Path, limits: Limits) -> tuple[str, ...]:
    """Of one log, as `flysid vehicle` finds and leaves them out: a task for a worker process."""
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.align.signals import FlightLog
    from flysid.ingest.align.vehicle_channel import vehicle_data
    from flysid.ingest.formats.registry import read
    from flysid.sixdof.records import flights_of

    try:
        data = vehicle_data([FlightLog(read(path, limits=limits))], load_recipe(RECIPE)).dataset
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

    signals = load_recipe(RECIPE).signals
    streams = tuple(
        {s.stream for name, own in signals.items() if name.startswith(MOTOR) for s in own.sources}
    )
    chosen = [
        path for path, found in surveys.items() if any(key.startswith(streams) for key in found.streams)
    ]
    look = partial(telemetry_lines, limits=limits)
    return {path: lines for path, lines in read_bounded(look, chosen, 1, bounds) if isinstance(lines, tuple)}
