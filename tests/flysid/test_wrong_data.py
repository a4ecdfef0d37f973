"""Wrong input from the command line: each error names its own cause, and the hint helps against that one."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from flysid.errors import FlysidError
from flysid.files import locked, unread_table, writing_to
from tests.command import call, call_quick

N = 600
U = [(-1) ** (k // 20 * 7 % 5) for k in range(N)]


def _y() -> Iterator[float]:
    y = 0.0
    for u in U:
        yield y
        y = 0.9 * y + 0.1 * u


Y = list(_y())
SOUND = [f"{k / 10},{U[k]},{Y[k]:.5f}" for k in range(N)]
TABLES = {
    "sound": SOUND,
    "still_input": [f"{k / 10},1,{Y[k]:.5f}" for k in range(N)],
    "still_output": [f"{k / 10},{U[k]},2" for k in range(N)],
    "short": SOUND[:8],
    "no_numbers": [f"{k / 10},{U[k]},nan" for k in range(N)],
    "words": [f"{k / 10},{U[k]},abc" for k in range(N)],
    "falling": [f"{(N - k) / 10},{U[k]},{Y[k]:.5f}" for k in range(N)],
    "standing": [f"1.0,{U[k]},{Y[k]:.5f}" for k in range(N)],
}
RECIPE = """
name = "own"
[signals.u]
unit = "deg"
sources = [{ stream = "table", field = "u", unit = "deg" }]
[signals.y]
unit = "m"
sources = [{ stream = "table", field = "y", unit = "m" }]
[channels.main]
inputs = ["u"]
outputs = ["y"]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wrong")
    for name, rows in TABLES.items():
        (folder / f"{name}.csv").write_text("t,u,y\n" + "\n".join(rows) + "\n")
    (folder / "empty.csv").touch()
    (folder / "photo.ulg").write_bytes(b"\xff\xd8\xff\xe0" + bytes(range(256)) * 8)
    (folder / "field.toml").write_text(RECIPE.replace('field = "y"', 'field = "yy"'))
    (folder / "unit.toml").write_text(RECIPE.replace('"u", unit = "deg"', '"u", unit = "m"'))
    (folder / "file").write_text("no folder")
    return folder


FIELDS = "--from u --to y"
FIT = f"fit sound.csv {FIELDS} -o new"
SAID = [
    (f"fit still_input.csv {FIELDS} -o new", "input 'u' stays at 1", "fly steps, doublets or a sweep"),
    (f"fit still_output.csv {FIELDS} -o new", "output 'y' stays at 2", "fly steps, doublets or a sweep"),
    (f"fit short.csv {FIELDS} -o new", "1 shorter one was dropped", "fly longer without pauses"),
    (f"fit no_numbers.csv {FIELDS} -o new", "samples of y not finite", "a source of y that holds numbers"),
    (f"fit words.csv {FIELDS} -o new", "table.y does not hold numbers", "choose a field of numbers"),
    (f"fit falling.csv {FIELDS} -o new", "no column that can be its time", "a time rises from row to row"),
    (f"fit standing.csv {FIELDS} -o new", "no column that can be its time", "a time rises from row to row"),
    (f"fit empty.csv {FIELDS} -o new", "the file is empty", "check that the download or copy finished"),
    ("fit photo.ulg -r px4-attitude -o new", "this is a picture, not a log", "give the log"),
    ("fit sound.csv --from u --to u -o new", "'u' is both input and output", "what answers --from"),
    ("fit sound.csv -r field.toml -o new", "signal 'y' needs table.yy", "has no field 'yy': one of t, u, y"),
    ("fit sound.csv -r unit.toml -o new", "m cannot become deg", "state the same kind of unit"),
    (f"{FIT} --mode LOITER", "the log states no modes", "leave out --mode"),
    (f"{FIT} --between 5:00..6:00", "ends after 60 s", "leave out --mode or --between"),
    (f"{FIT} --time-unit ms", "600 samples, 0.06 s, in 1 segment", "add flights, or longer"),
    (f"{FIT} --format ulog", "not a ULog", "leave out --format ulog"),
    (f"{FIT} --holdout sound", "no 20 samples in a row to train on", "hold out less"),
    (f"step sound.csv {FIELDS} --fast 50", "u never exceeds 50: at most ", "a smaller size"),
    (f"step sound.csv {FIELDS} --horizon 100", "no segment is longer than the response", "a shorter horizon"),
    (f"tf sound.csv {FIELDS} --dead-time 100", "longer than the dead time of 100 s", "a shorter dead"),
    (f"tf sound.csv {FIELDS} --band 1000 2000", "fewer than three frequencies", "these data reach from"),
    (f"tf sound.csv {FIELDS} --reference y", "'y' is an output", "a chirp, or a setpoint"),
    ("gains sound.csv", "records no rate loop", "the log that the vehicle wrote itself"),
]  # fmt: skip


@pytest.mark.parametrize(("line", "said", "hint"), SAID, ids=[line for line, *_ in SAID])
def test_wrong_data_are_named_with_what_helps_against_them(
    line: str, said: str, hint: str, place: Path
) -> None:
    done = call(*shlex.split(line), cwd=place)
    told = " ".join((done.stdout + done.stderr).split())
    assert done.returncode != 0 or "--fast" in line, told
    assert said in told
    assert hint in told
    assert "Traceback" not in told


def test_a_mode_that_never_holds_is_not_a_flight_that_was_not_held_out(place: Path) -> None:
    done = call_quick("fit", "sound.csv", *FIELDS.split(), "-o", "run", cwd=place)
    assert done.returncode == 0, done.stderr
    done = call("validate", "run", "--mode", "LOITER", cwd=place)
    assert done.returncode == 1
    assert "mode LOITER never holds: the log states no modes" in done.stderr
    assert "try:   choose what the log has, or leave out --mode or --between" in done.stderr


REFUSALS = [
    (28, "free space or choose another folder"),
    (13, "choose another folder"),
    (17, "a file is in the way of a folder"),
    (36, "choose a shorter name"),
    (24, "allow more open files"),
    (5, "look after that disk"),
]


@pytest.mark.parametrize(("number", "hint"), REFUSALS, ids=[os.strerror(n) for n, _ in REFUSALS])
def test_a_refusal_to_write_is_met_by_its_reason(number: int, hint: str, tmp_path: Path) -> None:
    with pytest.raises(FlysidError) as told, writing_to(tmp_path):
        raise OSError(number, os.strerror(number))
    assert told.value.hint.startswith(hint)
    assert ("free space" in told.value.hint) == (number == 28)


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="a folder in which nobody makes files")
def test_a_folder_that_takes_no_file_is_not_one_in_use() -> None:
    place = Path("/proc/run")
    with (
        pytest.raises(FlysidError, match="cannot be written: No such file or directory"),
        locked(place.with_name(".lock"), place),
    ):
        pass


def test_a_table_that_may_not_be_read_is_not_called_damaged(tmp_path: Path) -> None:
    refused = unread_table(PermissionError(13, os.strerror(13)), tmp_path, "ingest the log again")
    assert (refused.message, refused.hint) == (
        "cannot be read: Permission denied",
        "make it readable for this user",
    )
    broken = unread_table(OSError("Invalid parquet footer"), tmp_path, "ingest the log again")
    assert broken.hint == "ingest the log again"
