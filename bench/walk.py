"""How far a reader walks: `python -m bench.walk [FLYSID ARGUMENTS...]`, for example `validate run -o report`.

Without arguments: rooms (modules and folders) and floors (by imports) of every folder.

With arguments the command runs, and every function of flysid is noted where it is first called: in the order
in which a reader who follows the calls reads them. A *stay* is a stretch of that walk in one room, a *return*
is a stay in a room that was left before. `--inside PART` counts only rooms whose name holds PART. `--path`
prints the walk itself.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable
from itertools import groupby
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
TOPS = ("ingest", "model", "validate")


class Walk(NamedTuple):
    """The rooms of a walk, one for every stay."""

    stays: tuple[str, ...]

    @property
    def rooms(self) -> int:
        return len(set(self.stays))

    @property
    def returns(self) -> int:
        return len(self.stays) - self.rooms


def room_of(file: str) -> str:
    """The module that a file of this clone holds, without "flysid."; "" for any other file."""
    path = Path(file)
    if not path.is_relative_to(ROOT) or path.suffix != ".py":
        return ""
    parts = path.relative_to(ROOT).with_suffix("").parts
    if parts[0] == "flysid":
        return ".".join(parts[1:])
    return ".".join(parts) if parts[0] in TOPS else ""


def rooms_called(run: Callable[[], Any]) -> list[str]:
    """The room of every function that `run` calls, in the order of their first calls."""
    seen: dict[CodeType, str] = {}

    def note(frame: FrameType, event: str, _arg: Any) -> None:
        code = frame.f_code
        if event == "call" and code not in seen:
            seen[code] = "" if code.co_name == "<module>" else room_of(code.co_filename)

    sys.setprofile(note)
    try:
        run()
    finally:
        sys.setprofile(None)
    return [room for room in seen.values() if room]


def walk_through(rooms: Iterable[str], inside: str = "") -> Walk:
    """The walk through rooms, those left out whose name does not hold `inside`."""
    return Walk(tuple(room for room, _ in groupby(room for room in rooms if inside in room)))


def print_folders() -> None:
    """Rooms and floors of every folder."""
    import grimp

    from tests.layers import floors, folders

    graph = grimp.build_graph("flysid")
    print(f"{'folder':44}{'rooms':>6}{'floors':>8}")
    for folder in folders(graph):
        print(f"{folder:44}{len(graph.find_children(folder)):6}{len(floors(graph, folder)):8}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--inside", default="", metavar="PART")
    parser.add_argument("--path", action="store_true")
    parser.add_argument("words", nargs=argparse.REMAINDER)
    asked = parser.parse_args()
    if not asked.words:
        print_folders()
        return
    from flysid.cli import root

    rooms = rooms_called(lambda: root.main(asked.words, standalone_mode=False))
    walk = walk_through(rooms, asked.inside)
    if asked.path:
        print(*walk.stays, sep="\n")
    print(f"{len(rooms)} functions, {len(walk.stays)} stays in {walk.rooms} rooms, {walk.returns} returns")


if __name__ == "__main__":
    main()
