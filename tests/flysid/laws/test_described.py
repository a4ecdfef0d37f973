"""Which law a firmware's version gets, and that the tables are whole."""

from __future__ import annotations

import itertools
import tomllib
from importlib.resources import files

import pytest

from flysid.errors import DataError
from flysid.laws.described import BLACKBOX, blackbox_law


@pytest.mark.parametrize(
    ("revision", "since"),
    [
        ("Betaflight 3.1.3 (73b498e) OMNIBUS", (3, 1)),
        ("Betaflight 3.5.7 (x) Y", (3, 4)),
        ("Betaflight 4.2.9 (e097f4ab7) STM32F7X2", (4, 2)),
        ("Betaflight 4.5.1 (x) Y", (4, 4)),
        ("Betaflight 4.6.0 () SITL", (4, 6)),
        ("Betaflight 2025.12.0 (x) Y", (4, 6)),
        ("INAV 5.1.0 (x) Y", (2, 6)),
        ("INAV 6.1.1 (x) Y", (6, 0)),
        ("INAV 7.1.2 (8ae2c5b) X", (7, 0)),
        ("INAV 8.0.1 (x) Y", (8, 0)),
    ],
)
def test_a_version_gets_the_law_of_its_range(revision: str, since: tuple[int, int]) -> None:
    law = blackbox_law(revision)
    assert law.since == since
    assert law.exact


@pytest.mark.parametrize(
    ("revision", "title"),
    [
        ("Betaflight 3.0.1 (x) Y", "Betaflight 3.0, which is not described: the law of 3.1 stands in"),
        (
            "Betaflight 2026.6.0 (x) Y",
            "Betaflight 2026.6, which is not described: the law of 2025.12 stands in",
        ),
        ("INAV 9.0.0 (x) Y", "INAV 9.0, which is not described: the law of 8.0 stands in"),
    ],
)
def test_an_unknown_version_gets_the_nearest_law_and_says_so(revision: str, title: str) -> None:
    law = blackbox_law(revision)
    assert not law.exact
    assert law.title == title


@pytest.mark.parametrize("revision", ["EmuFlight 0.4.1 (x) Y", "Cleanflight 2.4.0 (x) Y", ""])
def test_a_fork_is_refused_with_what_is_described(revision: str) -> None:
    with pytest.raises(DataError, match="is not described") as refused:
        blackbox_law(revision)
    assert "Betaflight 3.1 to 2025.12, INAV 2.6 to 8.0" in refused.value.hint


def test_what_an_entry_does_not_state_it_takes_over() -> None:
    old, new = blackbox_law("Betaflight 4.0.0 (x)"), blackbox_law("Betaflight 4.6.0 (x)")
    assert old.scale == new.scale
    assert new.names["boost_other"] == ("d_max",)
    assert new.names["windup"] == old.names["windup"]
    assert (old.part("boost")["other"], new.part("boost")["other"]) == ("least", "most")


@pytest.mark.parametrize("name", BLACKBOX)
def test_the_ranges_of_a_table_follow_each_other(name: str) -> None:
    table = tomllib.loads(files("flysid.laws").joinpath(f"{name}.toml").read_text("utf-8"))
    spans = [(entry["since"], entry["until"]) for entry in table["law"]]
    assert all(since <= until for since, until in spans)
    assert all(before[1] < after[0] for before, after in itertools.pairwise(spans))
