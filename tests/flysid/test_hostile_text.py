"""Names and texts of a log, through every verb: no terminal, page or spreadsheet obeys them."""

from __future__ import annotations

import csv
import io
import random
import re
import zipfile
from pathlib import Path
from urllib.parse import quote

import pytest

from tests.command import Done, call, call_quick
from tests.flysid.studio.server import studio
from tests.flysid.test_escaping import runs
from tests.flysid.test_trust import VERBS_WITH_OPTIONS, arguments_of, every_option, long_name
from tests.samplelogs.mcap import json_topic, mcap_file

CAUSE = "=1+1<script>alert(1)</script>\x1b[2J"
ANSWER = "@x\u202e<img src=x>$^[bold]"
LINES = "x\r\ny: forged\u2028"
FIELDS = ("--from", CAUSE, "--to", ANSWER)
FILE = "=1+1<img src=x>\x1b[2J\u202e.mcap"
WITHOUT_LOGS = {"demo", "import", "record", "reproduce", "studio", "synth"}
"""Verbs that read no log from a file, and the studio, whose answers its own tests read."""
FORMS = (
    "--json",
    "--markdown",
    "--csv",
    "--params",
    "--messages",
    "--events",
    "--fields",
    "--table",
    "--term",
)
ARGUMENTS: dict[tuple[str, ...], tuple[str, ...]] = {
    ("tf",): (*FIELDS, "--poles", "1", "--dead-time", "0", "--no-refine"),
    ("step",): FIELDS,
    ("fit",): FIELDS,
    ("plot",): (ANSWER,),
}
PAGES: dict[tuple[str, ...], str] = {
    ("plot",): "page.html",
    ("review",): "page.html",
    ("scrub",): "copy.mcap",
    ("export",): "table.csv",
}


def flown(seed: int) -> bytes:
    """A flight of 10 s whose topic, fields and texts are hostile."""
    rng = random.Random(seed)
    rows = []
    cause = answer = 0.0
    for k in range(500):
        cause = rng.uniform(-1.0, 1.0) if k % 25 == 0 else cause
        answer = 0.9 * answer + 0.1 * cause + 0.001 * rng.gauss(0.0, 1.0)
        rows.append({CAUSE: cause, ANSWER: answer, "text": (CAUSE, ANSWER, LINES)[k % 3]})
    kinds = {CAUSE: "number", ANSWER: "number", "text": "string"}
    schema = {"type": "object", "title": LINES, "properties": {n: {"type": k} for n, k in kinds.items()}}
    return mcap_file([json_topic(LINES, schema, rows)])


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Hostile flights, their data folder, and a judged run of them."""
    folder = tmp_path_factory.mktemp("hostile")
    logs = [f"{k}{FILE}" for k in range(3)]
    for k, name in enumerate(logs):
        (folder / name).write_bytes(flown(k))
    for done in (
        call("ingest", *logs, "-o", "data", "-q", cwd=folder),
        call_quick("fit", "data", *FIELDS, "-o", "run", "-j", "1", cwd=folder),
        call("validate", "run", "-o", "judged", cwd=folder),
    ):
        assert done.returncode == 0, done.stderr
        assert_inert(done)
    return folder


def assert_inert(done: Done) -> None:
    for line in (done.stdout + done.stderr).split("\n"):
        assert line.isprintable(), line
        assert not line.startswith("y: forged")
    assert "Traceback" not in done.stderr


def assert_files_are_inert(folder: Path) -> None:
    for path in folder.rglob("*"):
        assert path.name.isprintable()
        assert path.resolve().is_relative_to(folder.resolve())
        if path.suffix in (".html", ".svg", ".md"):
            text = path.read_text().replace("\\<", "")
            assert "<script>alert" not in text
            assert "<img src=x" not in text
        if path.suffix in (".csv", ".md", ".toml", ".m", ".c", ".h", ".py"):
            assert all(line.isprintable() for line in path.read_text().split("\n")), path
        if path.suffix == ".csv":
            assert not any(runs(cell) for row in csv.reader(io.StringIO(path.read_text())) for cell in row)
        if path.suffix == ".xlsx":
            with zipfile.ZipFile(path) as archive:
                assert not any(b"<f>" in archive.read(name) for name in archive.namelist())


def test_a_run_of_hostile_names_is_inert(place: Path) -> None:
    assert_files_are_inert(place / "run")
    assert_files_are_inert(place / "judged")
    assert re.search(r"\\u001b|\\U0000202e", (place / "run" / "recipe.toml").read_text())  # kept as they were


@pytest.mark.parametrize("words", [w for w in VERBS_WITH_OPTIONS if w[0] not in WITHOUT_LOGS], ids=" ".join)
def test_every_verb_shows_names_of_a_log_as_text(words: tuple[str, ...], place: Path, tmp_path: Path) -> None:
    options = {long_name(option) for at, option in every_option() if at == words}
    target = ("-o", tmp_path / PAGES.get(words, "out")) if options & {"--output", "--out"} else ()
    given = arguments_of(words, place / f"0{FILE}", place / "run")
    for form in ((), *((form,) for form in FORMS if form in options)):
        again = ("--force",) if form and "--force" in options else ()
        run = call_quick if words == ("fit",) else call
        assert_inert(run(*words, *given, *ARGUMENTS.get(words, ()), *target, *again, *form, cwd=tmp_path))
    assert_files_are_inert(tmp_path)


@pytest.mark.parametrize("kind", ["csv", "parquet", "mat", "xlsx", "mcap"])
def test_every_export_of_hostile_names_is_inert(kind: str, place: Path, tmp_path: Path) -> None:
    if kind == "xlsx":
        pytest.importorskip("openpyxl", reason='openpyxl is not installed: pip install "flysid[xlsx]"')
    done = call("export", place / f"0{FILE}", "--to", kind, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert_inert(done)
    assert_files_are_inert(tmp_path)


def test_the_studio_answers_names_of_a_log_as_text(place: Path) -> None:
    """JSON escapes what a terminal obeys; pages hold names as text, under a policy of their own."""
    assert_inert(call("validate", "run", cwd=place))
    with studio(place / "data") as server:
        flights = [flight["id"] for flight in server.get("flights").json["flights"]]
        runs_there = [run["id"] for run in server.get("runs").json["runs"]]
        looks = (
            "",
            "/track",
            "/suggestions",
            "/review",
            "/review.html",
            "/spectrum",
            "/spectrum.svg",
            "/filters",
        )
        addresses = [f"flights/{flights[0]}{look}" for look in looks]
        addresses += [f"runs/{run}{look}" for run in runs_there for look in ("", "/report.html", "/worst")]
        addresses += ["flights", "runs", "models", "recipes", "jobs", f"flights/{CAUSE}", f"runs/{ANSWER}"]
        assert len(flights) == 3
        assert runs_there
        for address in addresses:
            answer = server.get(quote(address))
            assert answer.status in (200, 400, 404), (address, answer.body)
            is_json = answer.headers["content-type"] == "application/json"
            text = answer.body.decode()
            assert is_json or "content-security-policy" in answer.headers, address
            assert is_json or not re.search("<script>alert|<img src=x", text.replace("\\<", "")), address
            assert not re.search(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]", text), address


def test_a_wrong_call_shows_file_names_as_text(place: Path) -> None:
    names = [path.name for path in sorted(place.glob("*.mcap"))]
    for words in (("fit", *names, "-o", "new"), ("show", f"--{names[0]}"), (names[0], f"--{names[1]}")):
        done = call(*words, cwd=place)
        assert done.returncode == 2
        assert_inert(done)


@pytest.mark.parametrize("kind", ["csv", "parquet", "mcap"])
def test_a_column_called_as_the_time_is_exported(kind: str, tmp_path: Path) -> None:
    """MCAP ended in a traceback: the table held `time_s` twice."""
    rows = "".join(f"{k / 50},{k % 7}\n" for k in range(200))
    (tmp_path / "log.csv").write_text(f"time_s,x\n{rows}")
    done = call("export", "log.csv", "table", "--to", kind, "-o", f"out.{kind}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    shown = call("show", f"out.{kind}", "--fields", "--json", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    assert "time_s_2" not in shown.stdout


def test_a_heading_with_a_line_break_in_quotes_is_a_heading(tmp_path: Path) -> None:
    """A spreadsheet's headings of two lines were lost, and with them the column of time."""
    with (tmp_path / "log.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", "Roll\n(deg)", "Pitch\r\nangle"])
        writer.writerows([k / 50, k % 7, -k] for k in range(200))
    done = call("export", "log.csv", "table", "--to", "csv", "-o", "out.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    heads, *rows = csv.reader(io.StringIO((tmp_path / "out.csv").read_text()))
    assert heads == ["time_s", "Roll [deg]", "Pitch angle"]
    assert [float(row[0]) for row in rows] == [k / 50 for k in range(200)]
