"""Text from logs stays text in every file that flysid writes for other programs."""

from __future__ import annotations

import csv
import io
import shlex
import xml.etree.ElementTree as ElementTree
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from flysid.dataset import Signal
from flysid.escaping import csv_line, inert_cell, markdown
from flysid.export.csource import c_files, identifier
from flysid.export.matlab import matlab_files
from flysid.export.programs import program_of
from flysid.ingest.lake.chosen_flights import Selection
from flysid.ingest.lake.stretches import Stretches
from flysid.plan.flightplan import CommandedAxis, make_plan
from flysid.validate.runs.provenance import fit_command
from flysid.validate.runs.run import open_run
from tests.command import call
from tests.model_examples import fitted
from tests.released_files import released
from tests.samplelogs.mcap import json_topic, mcap_file

LIVE = (
    "=1+1", "=cmd|' /C calc'!A0", "+SUM(A1)", "-1+cmd|' /C calc'!A0", "@SUM(1)", "\t=1+1", "\r=1+1",
    "\uff1d1+1", '=HYPERLINK("http://127.0.0.1:9/","x")',
)  # fmt: skip
NUMBERS = ("-5", "+5.5e-3", "-.5", "1e9")
BEGINS = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")


def runs(cell: str) -> bool:
    """Whether a spreadsheet would compute a cell."""
    try:
        float(cell)
    except ValueError:
        return cell.startswith(BEGINS)
    return False


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A table whose names and texts are formulas."""
    path = tmp_path / "log.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", "=1+1", "-x", "@note", "gain"])
        texts = [*LIVE[:5], *NUMBERS, "a;=1+1", "plain"]
        writer.writerows([k / 50, k % 7, -k, texts[k % len(texts)], -0.5] for k in range(200))
    return path


def test_csv_holds_no_formula(log: Path, tmp_path: Path) -> None:
    assert call("export", log, "table", "--to", "csv", "-o", "out.csv", cwd=tmp_path).returncode == 0
    text = (tmp_path / "out.csv").read_text()
    heads, *rows = csv.reader(io.StringIO(text))
    assert [h.lstrip("'") for h in heads if h != "time_s"] == ["=1+1", "-x", "@note", "gain"]
    assert not any(runs(cell) for row in (heads, *rows) for cell in row)
    at = heads.index("'-x")
    assert [float(row[at]) for row in rows] == [-float(k) for k in range(200)]  # numbers are numbers
    for number in NUMBERS:
        assert f'"{number}"' in text


@pytest.mark.parametrize("name", ["\x1b[2J", "a\u202eb", "c\u2028d", "e\nskipped: all"])
def test_csv_and_json_hold_nothing_that_a_terminal_obeys(name: str, tmp_path: Path) -> None:
    """`cat out.csv` ran escape codes of a log, and a line break in a text began a line of its own."""
    schema = {"type": "object", "properties": {name: {"type": "number"}, "text": {"type": "string"}}}
    topic = json_topic("said", schema, [{name: 1.0, "text": name}] * 9)
    (tmp_path / "log.mcap").write_bytes(mcap_file([topic]))
    done = call("export", "log.mcap", "said", "--to", "csv", "-o", "out.csv", cwd=tmp_path)
    shown = [call("show", "log.mcap", *more, cwd=tmp_path) for more in ((), ("--json",), ("said", "--json"))]
    assert [one.returncode for one in (done, *shown)] == [0] * 4
    written = (tmp_path / "out.csv").read_bytes().decode().split("\n")
    lines = [*written, *(line for one in shown for line in one.stdout.split("\n"))]
    assert all(line.isprintable() and not line.startswith("skipped") for line in lines)


def test_excel_holds_no_formula(log: Path, tmp_path: Path) -> None:
    pytest.importorskip("openpyxl", reason='openpyxl is not installed: pip install "flysid[xlsx]"')
    assert call("export", log, "table", "--to", "xlsx", "-o", "out.xlsx", cwd=tmp_path).returncode == 0
    with zipfile.ZipFile(tmp_path / "out.xlsx") as archive:
        sheet = archive.read("xl/worksheets/sheet1.xml").decode()
        strings = "xl/sharedStrings.xml"
        sheet += archive.read(strings).decode() if strings in archive.namelist() else ""
    assert "<f>" not in sheet
    assert ">=1+1<" in sheet  # as it was: a text cell needs no quote
    assert "'=1+1" not in sheet


def test_matlab_names_are_names(log: Path, tmp_path: Path) -> None:
    from scipy.io import loadmat

    assert call("export", log, "table", "--to", "mat", "-o", "out.mat", cwd=tmp_path).returncode == 0
    [table] = [value for name, value in loadmat(tmp_path / "out.mat").items() if not name.startswith("__")]
    assert all(name.isidentifier() for name in table.dtype.names)


@pytest.mark.parametrize("end", ["svg", "png"])
def test_pictures_draw_names_as_they_are(tmp_path: Path, end: str) -> None:
    name = r"$\evil{x$"
    lines = [f"time_s,{name},<script>"] + [f"{k / 50},{k % 7},1" for k in range(200)]
    (tmp_path / "log.csv").write_text("\n".join([*lines, ""]))
    done = call("plot", "log.csv", name, "<script>", "-o", f"out.{end}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    if end == "svg":
        text = (tmp_path / "out.svg").read_text()
        assert "<script" not in text
        ElementTree.fromstring(text)


@given(st.lists(st.text() | st.sampled_from(LIVE) | st.floats(allow_nan=False) | st.none(), min_size=1))
@example(["a;=1+1", "b\t=1+1", 'c"', "-5"])
def test_a_line_of_csv_comes_back_and_runs_nowhere(cells: list[str | float | None]) -> None:
    line = csv_line(cells)
    assert "\n" not in line
    [back] = list(csv.reader([line])) or [[]]
    if cells != [None] and cells != [""]:
        assert len(back) == len(cells)
    for before, after in zip(cells, back, strict=False):
        assert not runs(after) or not isinstance(before, str)
    for separator in ";\t":  # as a spreadsheet of another language splits the file
        [parts] = list(csv.reader([line], delimiter=separator)) or [[]]
        texts = [cell for cell in cells if isinstance(cell, str)]
        assert not any(runs(part) and any(part in text[1:] for text in texts) for part in parts[1:])


def test_what_begins_no_formula_stays() -> None:
    for text in (*NUMBERS, "roll", "", "a=b", "'x", "0"):
        assert inert_cell(text) == text
    assert all(inert_cell(text) == f"'{text}" for text in LIVE)


EVIL = (
    "*/ system(\"rm -rf ~\"); /*", "x'); system('rm -rf ~'); %", "![x](http://127.0.0.1:9/)", "<img src=x>",
    "a | b", "x\nsystem('id')", "??/\nint x;", "\\", "%{", "`id`", "$(id)",
)  # fmt: skip


@pytest.mark.parametrize("evil", EVIL)
def test_sources_keep_names_in_comments_and_quotes(evil: str) -> None:
    model = fitted("arx")
    program = program_of(model)
    program = replace(
        program, inputs=(Signal(evil, evil),), outputs=(Signal(evil + "y", "m"),), title=program.title
    )
    name = identifier(evil)
    assert name.isidentifier()
    files = c_files(program, name)
    header = files[f"{name}.h"]
    assert header.count("*/") == header.count("/*")
    begin = header.index("*/")
    code = header[begin:] + files[f"{name}.c"][files[f"{name}.c"].index("*/") :]
    assert "system(" not in code
    assert "??/" not in header
    assert "![" not in files["README.md"]
    assert "<img" not in files["README.md"].replace("\\<", "")
    signals = [line for line in files["README.md"].splitlines() if line.startswith("| `u[")]
    assert all(line.replace("\\|", "").count("|") == 3 for line in signals)
    for text in matlab_files(model, program, name).values():
        for line in text.splitlines():
            assert not line.lstrip().startswith("system")
            assert line.strip() not in ("%{", "%}")


def test_a_plan_of_a_strangers_recipe_holds_no_formula() -> None:
    axes = (CommandedAxis("=1+1", 0.1, "m"), CommandedAxis('a,"b', 0.1, ""), CommandedAxis("c;=1+1", 0.1, ""))
    plan = make_plan("multisine", axes, (0.1, 2.0), 20.0, 20.0)
    [heads] = list(csv.reader([plan.csv().splitlines()[0]]))
    assert heads == ["time_s", "'=1+1 [m]", 'a,"b', "c;=1+1"]


def test_a_command_to_be_copied_runs_nothing_else() -> None:
    evil = "'; touch x; '"
    run = open_run(released()[-1] / "run")
    settings = replace(
        run.settings,
        by=evil,  # type: ignore[arg-type]
        seed=evil,  # type: ignore[arg-type]
        rules=evil,
        antecedents=(evil,),
        channels=(evil,),
        models=(evil,),
        effort=evil,
        selection=Selection((evil,), (evil,), evil, False, Stretches("", (evil,))),
    )
    words = shlex.split(fit_command(replace(run, recipe=evil, settings=settings)))
    assert words.count(evil) == 12
    assert "touch" not in words


def test_markdown_shows_names_as_they_are() -> None:
    assert markdown("![x](http://a)<b>|`c`") == "\\!\\[x\\](http://a)\\<b\\>\\|\\`c\\`"
