"""`flysid review FOLDER`: a series on the terminal, in the document and on the page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli import root
from tests.flysid.reviews.copter_log import copter_log, even, wander


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five flights of a copter whose P rises while its lag falls."""
    folder = tmp_path_factory.mktemp("flights")
    flown = ((2, 0.10, 0.060), (9, 0.10, 0.061), (10, 0.15, 0.050), (11, 0.15, 0.049), (30, 0.20, 0.041))
    for number, p, lag_s in flown:
        time_s = even(40.0, 100.0)
        noise = np.random.default_rng(number).normal(0.0, 2.0, len(time_s))
        columns = {
            "RDes": wander(time_s, number, 40.0),
            "R": wander(time_s - lag_s, number, 40.0) + noise,
        }
        gains = {"ATC_RAT_RLL_P": p, "ATC_RAT_RLL_I": 0.1, "ATC_RAT_RLL_D": 0.004}
        copter_log(folder, {"RATE": (time_s, columns)}, parameters=gains, name=f"f{number}.bin")
    return folder


def run(*words: str | Path) -> str:
    result = CliRunner().invoke(root, ["review", *map(str, words)])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_folder_is_a_series_of_25_lines_at_most(flights: Path) -> None:
    lines = run(flights).strip().splitlines()
    assert len(lines) <= 25
    assert lines[0] == "copter: 5 flights, by the numbers in their names"
    assert [line.split()[0] for line in lines[2:7]] == ["f2", "f9", "f10", "f11", "f30"]
    assert any(line.startswith("roll lag 61 -> 41 ms while ATC_RAT_RLL_P 0.1 -> 0.2") for line in lines)


def test_the_document_holds_the_series_and_every_review(flights: Path) -> None:
    document = json.loads(run(flights, "--json"))
    (own,) = document["series"]["vehicles"]
    assert [one["flight"] for one in own["flights"]] == ["f2", "f9", "f10", "f11", "f30"]
    assert own["flights"][0]["gains"]["roll"]["ATC_RAT_RLL_P"] == 0.1
    assert own["changed"][0]["settings"] == {"ATC_RAT_RLL_P": {"from": "0.1", "to": "0.15"}}
    assert len(document["reviews"]) == 5
    lags = [one["figures"]["roll lag"] for one in own["flights"]]
    assert lags == pytest.approx([60.0, 61.0, 50.0, 49.0, 41.0], abs=3.0)


def test_the_page_begins_with_the_series(flights: Path, tmp_path: Path) -> None:
    run(flights, "-o", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text("utf-8")
    assert page.index("copter: 5 flights") < page.index("f2.bin")
    assert "ATC_RAT_RLL_P 0.1 -&gt; 0.15" in page


def test_markdown_holds_it_too(flights: Path) -> None:
    text = run(flights, "--markdown")
    assert text.startswith("```\ncopter: 5 flights")
    assert text.count("**Tracking**") == 5
