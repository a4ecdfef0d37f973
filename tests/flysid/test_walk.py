"""The count of a reader's walk: stays, rooms and returns."""

from __future__ import annotations

from bench.walk import room_of, rooms_called, walk_through
from flysid.showing import counted, first_of


def test_a_walk_counts_stretches_and_returns() -> None:
    walk = walk_through(["a.one", "a.one", "b.two", "a.one", "c.three"])
    assert (len(walk.stays), walk.rooms, walk.returns) == (4, 3, 1)
    inside = walk_through(["a.one", "b.two", "a.one"], inside="a.")
    assert (len(inside.stays), inside.returns) == (1, 0)


def test_functions_are_noted_once_in_the_order_of_their_first_calls() -> None:
    def read() -> None:
        counted(2, "file")
        first_of(["a", "b", "c"], 2)
        counted(3, "file")

    assert [room for room in rooms_called(read) if room == "showing"] == ["showing", "showing"]


def test_a_room_is_a_module_of_this_clone() -> None:
    assert room_of(counted.__code__.co_filename) == "showing"
    assert room_of("/usr/lib/python3/json/decoder.py") == ""
