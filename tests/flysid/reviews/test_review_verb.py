"""`flysid review LOG`, and `flysid LOG`, as a user types them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import flysid
from flysid.cli import root
from flysid.errors import UsageError
from tests.flysid.reviews.copter_log import copter_log, even

SAMPLES = Path(__file__).resolve().parents[3] / "sample_logs"
LOG = SAMPLES / "01-multisine-seed1.tlog"


def run(*arguments: object) -> tuple[int, str, str]:
    """Exit code, stdout and stderr."""
    result = CliRunner().invoke(root, [str(a) for a in arguments], standalone_mode=False)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.return_value or 0, result.stdout, result.stderr


def test_a_log_in_place_of_a_verb_is_reviewed() -> None:
    assert run(LOG)[1] == run("review", LOG)[1]


def test_json_holds_every_fact_with_its_evidence() -> None:
    document = json.loads(run("review", LOG, "--json")[1])
    assert document["format"] == "flysid-review"
    assert document["sections"]["trust"]["facts"]["lost"]["value"] == "nothing"


def test_the_page_is_written_once(tmp_path: Path) -> None:
    page = tmp_path / "r.html"
    run("review", LOG, "-o", page)
    assert "<h1" in page.read_text("utf-8")
    with pytest.raises(Exception, match="the target exists"):
        run("review", LOG, "-o", page)


@pytest.mark.parametrize(("condition", "code"), [("trust.duration > 1", 4), ("trust.duration > 1e9", None)])
def test_a_condition_guards(condition: str, code: int | None) -> None:
    found = run("review", LOG, "--fail-if", condition)[0]
    assert found == code if code else found != 4


def test_several_flights_are_no_single_review() -> None:
    with pytest.raises(UsageError, match="it holds 4 flights"):
        flysid.review(SAMPLES)


def test_a_figure_that_is_not_determined_fails_its_guard() -> None:
    code, _, said = run("review", LOG, "--fail-if", "trust.flown > 1e9")
    assert code in (0, 3, 4)
    assert (code == 4) == ("does not exist" in said)


def test_a_condition_is_looked_at_before_the_log_is_read() -> None:
    with pytest.raises(Exception, match="condition"):
        run("review", "sample_logs/absent.tlog", "--fail-if", "5 +")


def test_a_file_that_is_not_there_is_no_verb() -> None:
    with pytest.raises(Exception, match="no verb and no file"):
        run("absent.bin")


def test_own_limits_grade_the_figure(tmp_path: Path) -> None:
    time_s = even(30.0, 10.0)
    rates = {name: 0.5 * np.sin(time_s) for name in ("RDes", "R", "ROut")}
    copter_log(tmp_path, {"RATE": (time_s, rates)})
    log, key = tmp_path / "flight.bin", "controller_roll_at_limit"
    words: tuple[list[str], ...] = ([], ["--limit", "tracking.at_limit=0,0.5"])
    documents = [json.loads(run("review", log, "--json", *more)[1]) for more in words]
    grades = [document["sections"]["tracking"]["facts"][key]["grade"] for document in documents]
    assert grades == ["good", "watch"]


@pytest.mark.parametrize(
    ("limit", "message"),
    [
        ("power.motor_spred=1,2", "no figure 'power.motor_spred' has a limit"),
        ("power.motor_spread", "is no limit"),
        ("power.motor_spread=1", "is no limit"),
        ("trust.flown=1,2", "no figure 'trust.flown' has a limit"),
    ],
)
def test_a_limit_that_is_none_is_refused_before_a_log_is_read(limit: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        run("review", "absent.bin", "--limit", limit)
