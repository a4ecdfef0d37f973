"""Markdown, CSV and notebook tables: complete, and harmless with hostile names."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import pytest

from flysid.dataset import Signal
from flysid.showing import percent, percentage
from flysid.validate.compare.words import change_words, interval_words
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.caution import Caution
from flysid.validate.show.shown import ShownComparison
from flysid.validate.show.tables import to_csv, to_html, to_markdown
from tests.fakes import FirstOrder, flown

EVIL = "=cmd|' /C calc'!A1\n<b>|`x`"


def compared(name: str = "roll") -> ShownComparison:
    signals = (Signal(name, "m/s"),)
    arx = FirstOrder(b=0.07, outputs=signals)
    ts = FirstOrder(structure="ts", outputs=signals)
    return compare([arx, ts], replace(flown(ts, [300] * 5, noise=0.02), outputs=signals, name=name))


def test_csv_holds_every_segment_and_reads_back() -> None:
    c = compared()
    rows = list(csv.DictReader(io.StringIO(to_csv({"roll": c}))))
    assert len(rows) == 3 * 2 * (1 + 5)
    (pooled,) = [r for r in rows if (r["horizon"], r["model"], r["segment"]) == ("free_run", "ts", "")]
    assert float(pooled["rmse"]) == c.entry().models["ts"].scores.rmse
    assert float(pooled["change_pct"]) == c.verdict["roll"].change_pct
    assert pooled["verdict"] == "better"


def test_csv_cells_are_no_formulas() -> None:
    for row in csv.reader(io.StringIO(to_csv({EVIL: compared(EVIL)}))):
        assert len(row) == 22
        for cell in row:
            assert not cell.startswith(("=", "@"))
            assert not cell.startswith("+") or float(cell)
            assert not cell.startswith("-") or float(cell)


def test_markdown_is_one_table_whatever_the_names() -> None:
    calm = to_markdown({"roll": compared()}).splitlines()
    assert calm[0].startswith(
        "- **roll**: TS better on another flight like these (one rule: linear); free run: RMSE 0."
    )
    assert calm[1].startswith(
        "- RMSE, FIT and VAF are of all held-out samples together. CHANGE is of a typical"
    )
    assert calm[5].startswith("| roll | free run | ts | 0.0")
    evil = to_markdown({EVIL: compared(EVIL)})
    assert len(evil.splitlines()) == len(calm)
    assert "<b>" not in evil
    for line in evil.splitlines()[3:]:
        assert line.replace("\\|", "").count("|") == 13


def test_markdown_says_what_to_beware_of_and_what_was_not_judged() -> None:
    beware = Caution("warning", "Inputs leave the range on a_b.", "train on more.")
    lines = to_markdown({"roll": compared()}, None, [beware], {"yaw": "too | short"}).splitlines()
    assert lines[1] == "- **yaw**: not judged: too \\| short"
    assert lines[4:7] == [
        "Before you rely on this:",
        "",
        "- warning: Inputs leave the range on a\\_b. train on more.",
    ]
    assert lines[7] == ""
    assert lines[8].startswith("| channel |")


def test_notebook_table_escapes() -> None:
    html = str(to_html({EVIL: compared(EVIL)}))
    assert "<b>" not in html
    assert html.count("<tr>") == 7
    assert compared()._repr_html_().startswith("<ul><li><strong>roll</strong>: TS better")


def test_zero_has_no_sign() -> None:
    assert percentage(-0.04) == "0.0"
    assert percentage(-0.06) == "−0.1"


def test_a_large_change_below_the_resolution_is_not_quoted() -> None:
    (pair,) = compared().verdict.values()
    assert pair.change_pct is not None
    assert abs(pair.change_pct) > 10.0
    blurred = replace(pair, evidence=replace(pair.evidence, resolution=1e9))
    assert (change_words(blurred), interval_words(blurred)) == ("< resolution", "")
    assert change_words(replace(blurred, change_pct=-0.4)) == "−0.4 %"
    assert change_words(pair) == percent(pair.change_pct, 1)


def test_percentages_of_hopeless_models_stay_short() -> None:
    wild = FirstOrder(a=1.2, b=0.07, limit=1e6, structure="ts")
    text = to_markdown({"x": compare([FirstOrder(), wild], flown(FirstOrder(), [300] * 5, noise=0.02))})
    assert "< −999" in text
    assert "diverged" in text


@pytest.mark.parametrize("function", [to_csv, to_markdown, to_html])
def test_nothing_compared_is_an_empty_table(function: object) -> None:
    assert callable(function)
    assert len(str(function({})).splitlines()) <= 2
