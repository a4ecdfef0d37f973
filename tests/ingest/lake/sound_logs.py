"""Small sound logs, each with a content of its own."""

from __future__ import annotations

from pathlib import Path

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
