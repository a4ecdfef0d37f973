"""Small sound logs, each with a content of its own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from flysid.ingest.formats.registry import FORMATS
from tests.format_trials import module_of, sample

SOUND = 12


def sound_table(number: int) -> bytes:
    """A table of a few rows."""
    return b"time_s,u,y\n" + b"".join(b"%d,%d,%d\n" % (k, number, k * number) for k in range(5))


def write_sound(folder: Path, count: int = SOUND) -> list[Path]:
    """Put sound logs into a folder that is made; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"sound{number:02}.csv" for number in range(count)]
    for number, path in enumerate(paths):
        path.write_bytes(sound_table(number))
    return paths


def sound_mixture(count: int) -> Mapping[str, bytes]:
    """Sound logs by name: one of each format, and tables."""
    samples = {f"sound_{kind}{module_of(kind).SUFFIX}": sample(kind) for kind in FORMATS}
    tables = {f"sound{number:02}.csv": sound_table(number) for number in range(count - len(samples))}
    return samples | tables
