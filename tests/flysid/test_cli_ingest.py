"""`flysid ingest`, `ls`, `show`, `doctor` as a user meets them."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from rich.console import Console

from flysid.cli import root
from flysid.cli.display import State, drawn
from flysid.errors import UsageError, WriteError
from flysid.files import writing_to
from flysid.ingest.lake.survey import survey
from flysid.progress import Step
from tests.samplelogs import dataflash, tlog

LOGS = Path(__file__).resolve().parents[3] / "shared" / "logs"


def flysid(*words: str | Path) -> Result:
    """Run a command; errors surface as exceptions, exit codes as the return value."""
    return CliRunner().invoke(root, [str(w) for w in words], standalone_mode=False)


def code(result: Result) -> int:
    if result.exception is not None:
        raise result.exception
    return int(result.return_value or 0)


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "one.tlog").write_bytes(tlog.build())
    (folder / "two.bin").write_bytes(dataflash.build())
    return folder


def test_ids_go_to_stdout_and_words_to_stderr(tmp_path: Path, logs: Path) -> None:
    first = flysid("ingest", logs, "-o", tmp_path / "data")
    assert code(first) == 0
    assert [line.rpartition("-")[0] for line in first.stdout.splitlines()] == ["one", "two"]
    assert "2 logs ingested" in first.stderr
    again = flysid("ingest", logs, "-o", tmp_path / "data")
    assert (code(again), again.stdout) == (0, "")
    assert "2 unchanged" in again.stderr


def test_losses_are_named_with_their_bytes(tmp_path: Path, logs: Path) -> None:
    blob = tlog.build()
    (logs / "bad.tlog").write_bytes(blob[:28] + b"garbage" + blob[28:])
    cut = tlog.records(blob)[0].end
    (logs / "bad.tlog").write_bytes(blob[:cut] + b"garbage" + blob[cut:])
    result = flysid("ingest", logs, "-o", tmp_path / "data", "-q")
    assert code(result) == 3
    assert f"7 bytes skipped in 1 place: {cut}-{cut + 7}" in result.stderr
    assert len(result.stdout.splitlines()) == 3


def test_json_says_what_became_of_every_log(tmp_path: Path, logs: Path) -> None:
    (logs / "empty.tlog").touch()
    result = flysid("ingest", logs, "-o", tmp_path / "data", "--json", "-q")
    assert code(result) == 3
    found = {Path(item["path"]).name: item for item in json.loads(result.stdout)["logs"]}
    assert {name: item["status"] for name, item in found.items()} == {
        "empty.tlog": "skipped",
        "one.tlog": "ingested",
        "two.bin": "ingested",
    }
    assert found["empty.tlog"]["reason"] == "the file is empty; try: check that the download or copy finished"
    assert found["one.tlog"]["damage"]["bytes_skipped"] == 0


def test_nothing_readable_is_a_failure(tmp_path: Path) -> None:
    (tmp_path / "no.tlog").write_text("hello\n" * 50)
    assert code(flysid("ingest", tmp_path / "no.tlog", "-o", tmp_path / "data")) == 1


def test_ls_and_show_answer_from_the_manifests(tmp_path: Path, logs: Path) -> None:
    code(flysid("ingest", logs, "-o", tmp_path / "data", "-q"))
    for parquet in (tmp_path / "data").rglob("*.parquet"):
        parquet.unlink()
    listed = flysid("ls", tmp_path / "data")
    assert code(listed) == 0
    assert len(listed.stdout.splitlines()) == 3
    document = json.loads(flysid("ls", tmp_path / "data", "--json").stdout)
    assert [f["format"] for f in document["flights"]] == ["tlog", "dataflash"]
    shown = flysid("show", tmp_path / "data", "one")
    assert "1.1/ATTITUDE" in shown.stdout
    assert "50.0 Hz" in shown.stdout
    manifest = json.loads(flysid("show", tmp_path / "data", "one", "--json").stdout)
    assert manifest["format"] == "flysid-flight"


def test_show_prints_columns_and_first_rows(tmp_path: Path, logs: Path) -> None:
    code(flysid("ingest", logs / "two.bin", "-o", tmp_path / "data", "-q"))
    shown = flysid("show", tmp_path / "data", "two", "GPS", "-n", "2")
    assert "1e-07" in shown.stdout
    assert shown.stdout.count("491234567") == 2


def test_control_characters_in_names_do_not_reach_the_terminal(tmp_path: Path) -> None:
    (tmp_path / "a\x1b[31mred.tlog").write_bytes(tlog.build()[:-5])
    result = flysid("ingest", tmp_path / "a\x1b[31mred.tlog", "-o", tmp_path / "data")
    listed = flysid("ls", tmp_path / "data")
    doctor = flysid("doctor", tmp_path / "a\x1b[31mred.tlog")
    assert "\x1b" not in result.output + listed.output + doctor.output


def test_doctor_gives_a_row_per_log_and_below_what_there_is_to_say_of_it(logs: Path) -> None:
    (logs / "cut.bin").write_bytes(dataflash.build()[:-4])
    (logs / "no.tlog").write_text("hello\n" * 50)
    result = flysid("doctor", logs)
    assert code(result) == 3
    lines = result.stdout.splitlines()
    assert [line.split()[0] for line in lines[:4]] == ["FILE", "cut.bin", "one.tlog", "two.bin"]
    assert lines[1].split()[-3:-1] == ["yes", "too"]
    assert " 50 " in lines[2]
    assert "4.3.1" in lines[3]
    [lost] = [line for line in lines[4:] if line.startswith("cut.bin: lost")]
    assert "end cut off" in lost
    assert max(map(len, lines)) <= 100
    assert "skipped" in result.stderr
    two = flysid("doctor", logs / "one.tlog", logs / "two.bin", "--json", "--progress", "json")
    steps = [json.loads(line) for line in two.stderr.splitlines() if line.startswith("{")]
    told = dict.fromkeys((s["log"], s["stage"], s["share"]) for s in steps)  # said again in long silence
    assert list(told) == [("one.tlog", "examining", 0.0), ("two.bin", "examining", 0.5)]
    document = json.loads(two.stdout)["logs"][0]
    assert document["rates_hz"]["attitude"] == {"1.1/ATTITUDE": pytest.approx(50.0)}
    assert document["moved"] == "r"


def test_doctor_stays_within_the_width_with_long_names_and_leaves_out_empty_columns(tmp_path: Path) -> None:
    for i in range(2):
        log = dataflash.build()
        (tmp_path / f"{'a-long-name-of-a-flight-' * 4}{i}.bin").write_bytes(log)
    lines = flysid("doctor", tmp_path).stdout.splitlines()
    assert max(map(len, lines[:3])) <= 100
    assert "…" in lines[1]
    (tmp_path / "t.csv").write_text("t,a\n0,1\n0.1,2\n0.2,3\n")
    table = flysid("doctor", tmp_path / "t.csv").stdout.splitlines()
    assert table[0].split() == ["FILE", "TIME", "LOST", "VERDICT"]
    assert "to 'flysid fit': --from, --to" in " ".join(line.strip() for line in table[2:])


def test_a_failed_ingest_leaves_no_folder(tmp_path: Path, logs: Path) -> None:
    (tmp_path / "no.tlog").write_text("hello\n" * 50)
    assert code(flysid("ingest", tmp_path / "no.tlog", "-o", tmp_path / "data")) == 1
    assert not (tmp_path / "data").exists()
    code(flysid("ingest", logs, "-o", tmp_path / "data"))
    assert code(flysid("ingest", tmp_path / "no.tlog", "-o", tmp_path / "data")) == 1
    assert len(flysid("ls", tmp_path / "data").stdout.splitlines()) == 3
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "flysid").mkdir()
    with pytest.raises(UsageError, match="not an ingested folder"):
        code(flysid("ingest", tmp_path / "no.tlog", "-o", tmp_path / "mine"))
    assert (tmp_path / "mine" / "flysid").is_dir()


def test_names_with_brackets_are_no_markup(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    path = tmp_path / "[red]flight[bold.tlog"
    path.write_bytes(tlog.build())
    assert code(flysid("ingest", path, "-o", tmp_path / "data")) == 0
    state = State()
    state.hear(Step("fitting [/red]", channel="[bold]", model="[/red]", validation=0.5))
    console = Console(width=100)
    with console.capture() as captured:
        console.print(drawn(state))
    assert "[/red]: fitting [/red]" in captured.get()


def test_show_names_the_flights_where_it_is_not_told_which(tmp_path: Path, logs: Path) -> None:
    code(flysid("ingest", logs, "-o", tmp_path / "data"))
    with pytest.raises(UsageError, match="the folder holds 2 flights") as caught:
        code(flysid("show", tmp_path / "data"))
    assert caught.value.hint.startswith("name one: one-")
    shown = flysid("show", tmp_path / "data", "two")
    assert " in 1 boot\n" in shown.stdout
    with pytest.raises(UsageError, match="no stream 'ATTT'") as caught:
        code(flysid("show", tmp_path / "data", "two", "ATTT"))
    near = caught.value.hint.split(", ")
    assert len(near) == len(set(near))


def test_a_log_is_listed_as_the_folder_that_it_would_make(logs: Path) -> None:
    assert "\none-" in flysid("ls", logs / "one.tlog").stdout


def test_what_cannot_be_written_says_what_would_help(tmp_path: Path) -> None:
    path = tmp_path / "nowhere" / "copy.tlog"
    with pytest.raises(WriteError, match="No such file") as caught, writing_to(path):
        path.write_bytes(b"")
    assert caught.value.hint == "make the folder that it is to be in first"


def test_angles_that_are_no_numbers_make_no_noise(tmp_path: Path) -> None:
    rows = "\n".join(
        f"{k * 0.02:.2f},{'nan' if k % 7 else 'inf'},{1e300 if k % 2 else 0.1}" for k in range(200)
    )
    (tmp_path / "a.csv").write_text("t,roll,pitch\n" + rows + "\n")
    found = survey(tmp_path / "a.csv")
    assert found.streams
    assert found.excited() in ("-", "?")


@pytest.mark.skipif(not LOGS.is_dir(), reason="../shared/logs is not there")
def test_the_shared_tlogs_are_ingested(tmp_path: Path) -> None:
    result = flysid("ingest", LOGS / "tlog", "-o", tmp_path / "data", "-j", "1")
    assert code(result) == 3
    assert len(result.stdout.splitlines()) == 6
    assert "2,565 bytes skipped in 10 places: 0-1359" in result.stderr
    assert "sitl_x27_two_boots_stray_bytes.tlog" in result.stderr


@pytest.mark.parametrize("verb", ["doctor LOG", "ingest LOG -o OUT", "scrub LOG -o OUT", "export LOG -o OUT"])
def test_a_format_can_be_named_on_every_verb(tmp_path: Path, logs: Path, verb: str) -> None:
    log = tmp_path / "unknown"
    log.write_bytes(random.Random(2).randbytes(200_000) + (logs / "one.tlog").read_bytes())
    words = [{"LOG": log, "OUT": tmp_path / "out"}.get(word, word) for word in verb.split()]

    def ends_with(*more: str) -> int:
        done = flysid(*words, *more)
        return int(getattr(done.exception, "exit_code", 0) or done.return_value or 0)

    assert ends_with() == 1
    assert ends_with("--format", "tlogs") == 2
    assert ends_with("--format", "tlog") == 3
