"""What a user chooses of the flights: in the fit, stored in the run, on the page, and at the verdict."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from flysid.ingest.lake.stretches import Stretches
from flysid.validate.runs.run import open_run
from tests.command import call, call_quick


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with six ingested flights, and a run of 15 s of five of them."""
    folder = tmp_path_factory.mktemp("chosen")
    made = call("synth", "-o", "logs", "--duration", "20", "--format", "mcap", "-q", cwd=folder)
    assert made.returncode == 0
    assert call("ingest", "logs", "-o", "data", "-q", cwd=folder).returncode == 0
    out = first_flight(folder)
    words = (
        "fit",
        "data",
        "-r",
        "ardrone-synthetic",
        "-c",
        "lateral",
        "-o",
        "run",
        "-j",
        "1",
        "--no-rotate",
        "--holdout",
        "0.5",
    )
    done = call_quick(*words, "--exclude", out, "--between", "0:02..0:17", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


def first_flight(folder: Path) -> str:
    return sorted(path.name for path in (folder / "data/flights").iterdir() if path.is_dir())[0]


def test_the_run_remembers_the_choice(place: Path) -> None:
    run = open_run(place / "run")
    assert run.settings.selection.exclude == (first_flight(place),)
    assert run.settings.selection.stretches == Stretches("0:02..0:17")
    assert len(run.flights) == 5
    assert first_flight(place) not in run.flights


def test_the_page_shows_it_and_the_verdict_rests_on_it(place: Path) -> None:
    assert call("validate", "run", "-q", cwd=place).returncode == 0
    page = (place / "run/report/report.html").read_text()
    assert f"--exclude {first_flight(place)} --between 0:02..0:17" in page
    document = json.loads((place / "run/report/report.json").read_text())
    assert document["provenance"]["chosen"].endswith("--between 0:02..0:17")
    held = json.loads((place / "run/run.json").read_text())["channels"][0]
    assert "only 0:02..0:17 of the flight, as asked" in " ".join(held["aligned"])


def test_a_verdict_on_some_of_what_was_held_out(place: Path) -> None:
    run = open_run(place / "run")
    held = [flight for flight in run.flights if flight in judged(place)]
    assert judged(place, "--flight", held[0]) == {held[0]}
    assert judged(place, "--exclude", held[0]) == set(held) - {held[0]}
    shorter = call("validate", "run", "-o", "part", "--between", "0:04..0:10", "--json", "-q", cwd=place)
    assert shorter.returncode == 0, shorter.stderr
    trained = next(flight for flight in run.flights if flight not in held)
    none = call("validate", "run", "-o", "none", "--flight", trained, cwd=place)
    assert none.returncode == 1
    assert "lateral: none of the chosen data was held out\n" in none.stderr
    assert "try:   choose among what was held out: " in none.stderr
    assert held[0] in none.stderr


def judged(place: Path, *options: str) -> set[str]:
    """Flights that the verdict rests on."""
    from flysid.validate.runs.judge import judge_run

    selection = None
    if options:
        from flysid.ingest.lake.chosen_flights import Selection

        name = {"--flight": "flights", "--exclude": "exclude"}[options[0]]
        selection = Selection(**{name: (options[1],)})  # type: ignore[arg-type]
    judgement = judge_run(open_run(place / "run"), only=selection)
    return set(judgement.comparisons["lateral"].test.flights)


def test_a_time_that_cannot_be_is_refused_before_anything_is_read(place: Path) -> None:
    done = call("fit", "data", "-r", "ardrone-synthetic", "-o", "other", "--between", "5..2", cwd=place)
    assert done.returncode == 2
    assert "12:30..14:00" in done.stderr


def test_a_folder_of_logs_and_a_pattern_are_read_as_an_ingested_folder_is(place: Path) -> None:
    words = ("-r", "ardrone-synthetic", "-c", "lateral", "-m", "arx", "--no-rotate", "-j", "1", "-q")
    for source, run in (("logs", "of_logs"), ("logs/*.mcap", "of_pattern"), ("data", "of_data")):
        done = call_quick("fit", source, *words, "-o", run, cwd=place)
        assert done.returncode == 0, done.stderr
    models = [(place / run / "lateral/arx.json").read_bytes() for run in ("of_logs", "of_pattern", "of_data")]
    assert models[0] == models[1] == models[2]
    assert (place / "of_logs.data/flysid-data.json").is_file()
    listed = call("ls", "logs/*.mcap", cwd=place)
    assert listed.returncode == 0, listed.stderr
    missing = call("fit", "nowhere", *words, "-o", "none", cwd=place)
    assert missing.returncode == 2
    assert "no such file or folder" in missing.stderr
