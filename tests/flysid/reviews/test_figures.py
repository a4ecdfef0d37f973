"""The table of figures: every row is stated somewhere, and what follows from a limit follows from its row."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from pathlib import Path

import pytest

import flysid.reviews
from flysid.reviews.fact import Grade
from flysid.reviews.figures import absent, actions_of, fact_of, findings_of, limit, own_limits

ROWS = tomllib.loads(files("flysid.reviews").joinpath("figures.toml").read_text("utf-8"))
LEAST_S = ROWS.pop("least_s")
KEYS = [f"{section}.{name}" for section, rows in ROWS.items() for name in rows]
SOURCES = "".join(path.read_text("utf-8") for path in Path(flysid.reviews.__path__[0]).glob("*.py"))


@pytest.mark.parametrize("key", KEYS)
def test_every_row_is_stated_by_a_section(key: str) -> None:
    """Names of margins and of an oscillation's frequency are put together from their ends."""
    end = key.rpartition("}_")[2]
    assert key in SOURCES or (key.startswith("tracking.") and end in SOURCES)


def test_a_figure_needs_what_its_section_does_unless_its_row_says_so() -> None:
    assert limit("tracking.rate").least_s == LEAST_S["tracking"]
    assert limit("power.desync").least_s == 0.0
    assert LEAST_S.keys() <= ROWS.keys()


@pytest.mark.parametrize("key", KEYS)
def test_a_limit_has_both_ends(key: str) -> None:
    section, _, name = key.partition(".")
    assert ("watch" in ROWS[section][name]) == ("bad" in ROWS[section][name])


def test_a_fact_beyond_its_limit_says_so_and_what_to_do() -> None:
    fact = fact_of("estimator.compass_change", 64.2, ("MAG.MagX",), note="over the range of the current")
    (finding,) = findings_of([fact])
    (action,) = actions_of([fact])
    assert fact.grade is finding.grade is Grade.BAD
    assert finding.text == "The current turns the compass's field by 64 %"
    assert finding.more == limit("estimator.compass_change").source
    assert action.reason == "the magnetic field changes by 64.2 % with the current"


def test_what_is_good_or_unknown_needs_no_word() -> None:
    quiet = [fact_of("estimator.jamming", 12.0), absent("estimator.cpu_load", "it is not logged")]
    assert not list(findings_of(quiet)) + list(actions_of(quiet))


def test_fewer_is_worse_where_the_row_says_so() -> None:
    grades = [fact_of("estimator.satellites", count).grade for count in (14.0, 9.0, 5.0)]
    assert grades == [Grade.GOOD, Grade.WATCH, Grade.BAD]


def test_own_limits_hold_for_figures_of_the_same_limit_and_end_with_their_block() -> None:
    with own_limits({"estimator.test_ratio": (0.1, 0.2)}):
        strict = fact_of("estimator.{kind}_ratio", 0.3, kind="height")
    assert (strict.grade, strict.note) == (Grade.BAD, "your limits: 0.1 and 0.2")
    assert fact_of("estimator.{kind}_ratio", 0.3, kind="height").grade is Grade.GOOD
