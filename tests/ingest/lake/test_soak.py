"""The soak runner itself: campaigns are found, outcomes become lines, lines of others stay."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from soak import Budget, Campaign, Outcome, instrument, peak_memory, row_07_fuzz
from soak.__main__ import PAGE, campaigns, chosen
from soak.row_07_fuzz import fuzz_apart
from soak.table import line, merge, parse


def test_every_campaign_is_found_and_has_a_name_of_its_own() -> None:
    names = [c.name for c in campaigns().values()]
    assert "truncation at every byte" in names
    assert len(set(names)) == len(names)


def test_campaigns_are_chosen_by_row_or_by_a_part_of_the_name() -> None:
    assert "row_01_truncation" in chosen(["1"])
    assert list(chosen(["truncation at"])) == ["row_01_truncation"]
    with pytest.raises(SystemExit, match="no campaign 'nonsense'"):
        chosen(["nonsense"])


def test_new_outcomes_replace_those_of_their_campaign_only() -> None:
    mine, other = (Campaign(2, name, lambda _: iter(())) for name in ("mine", "other"))
    page = "before\n<!-- soak: begin -->\n<!-- soak: end -->\nafter\n"
    page = merge(
        page, [line(mine, Outcome("a", 3), "2026-01-01"), line(other, Outcome("a", 4), "2026-01-01")]
    )
    outcome = Outcome("b", 5, kept=99, lost=1, failures=["x"], peak_mb=1.6, slowest_s=0.123, remark="a|b")
    page = merge(page, [line(mine, outcome, "2026-01-02")])
    assert page.startswith("before\n")
    assert page.endswith("\nafter\n")
    assert parse(page) == [
        ("2", "mine", "b", "5", "99 of 100 (99.000 %)", "0", "1", "2", "0.12", "a/b", "2026-01-02"),
        ("2", "other", "a", "4", "", "0", "0", "", "", "", "2026-01-01"),
    ]
    page = merge(page, [line(mine, Outcome("c", 7), "2026-01-03")], part=True)
    assert [cells[2:4] for cells in parse(page)] == [("b", "5"), ("c", "7"), ("a", "4")]
    with pytest.raises(ValueError, match="has no"):
        merge("a page without marks", [])


def test_the_page_has_its_marks() -> None:
    text = PAGE.read_text("utf-8")
    assert merge(text, []).count("\n") >= text.count("\n") - 1


def test_a_budget_runs_out_and_none_does_not() -> None:
    assert Budget().clock()()
    assert not Budget(0.0).shares(2)[0].clock()()
    assert Budget().chosen("ab") == ["a", "b"]
    assert Budget(subjects=("b",)).chosen("ab") == ["b"]


def test_trials_are_counted_and_memory_is_seen() -> None:
    outcome = Outcome("a")
    with peak_memory(outcome), outcome.trial():
        block = bytearray(b"x" * (32 << 20))
    assert len(block)
    assert outcome.trials == 1
    assert outcome.peak_mb is None or outcome.peak_mb > 25


def test_blocks_are_counted_and_code_does_what_it_did(monkeypatch: pytest.MonkeyPatch) -> None:
    source = """
def f(n):
    'A docstring.'
    even = 0
    for k in range(n):
        if k % 2 == 0 and k > 0 or k == 7:
            even += 1
    return 'many' if even > 2 else 'few'
"""
    monkeypatch.setattr(instrument, "HITS", [])
    space: dict[str, Any] = {instrument.NAME: instrument.hit}
    exec(instrument.counting(source, "f.py"), space)
    assert space["f"].__doc__ == "A docstring."
    found = []
    for n, answer in ((0, "few"), (3, "few"), (4, "few"), (12, "many")):
        instrument.reset()
        assert space["f"](n) == answer
        found.append(instrument.taken())
    assert len({place for place, _ in found[0]}) == 2  # the body, and "few"
    assert {place for place, _ in found[1]} == {place for place, _ in found[2]}
    assert found[1] != found[2]  # by how often
    assert len(found[3] - found[2]) >= 3


def test_a_reader_is_fuzzed_in_a_process_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = fuzz_apart("dataflash_text", 0.5)
    assert outcome.failures == []
    assert outcome.trials > 2
    monkeypatch.setattr(row_07_fuzz, "FOUND", tmp_path)
    monkeypatch.setattr(row_07_fuzz, "last_input", lambda _: tmp_path / "last")
    (tmp_path / "last").write_bytes(b"fatal")
    dead = fuzz_apart("no such format", 0.5)
    assert "ended with 1" in dead.failures[0]
    assert [p.read_bytes() for p in tmp_path.iterdir()] == [b"fatal"]
