"""What a link lost on the way is said wherever its log is used, not only where logs are read."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from click.testing import CliRunner

from flysid.catalogue import catalogue
from flysid.cli import root
from flysid.cli.output import ExitCode
from tests.command import call, call_quick
from tests.samplelogs import tlog

FIELDS = ("--from", "ATTITUDE.pitch", "--to", "ATTITUDE.roll")
LOST = frozenset(range(700, 737))
WORDS = f"{len(LOST)} on the link"


def link_with_losses() -> bytes:
    """A command in steps and a lag that follows it, 50 Hz; the file is whole, the link was not."""
    vehicle = tlog.sender()
    draw = random.Random(3)
    command = angle = 0.0
    records = []
    for k in range(3000):
        command = draw.uniform(-0.4, 0.4) if k % 25 == 0 else command
        angle += 0.2 * (command - angle)
        packed = tlog.frame(
            vehicle, vehicle.attitude_encode(5000 + 20 * k, angle, command, 0.0, 0.0, 0.0, 0.0)
        )
        if k not in LOST:
            records.append(tlog.stamped(tlog.EPOCH_US + 20_000 * k, packed))
    return b"".join(records)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("losses")
    (folder / "link.tlog").write_bytes(link_with_losses())
    done = call("ingest", "link.tlog", "-o", "data", cwd=folder)
    assert done.returncode == 0  # the file itself is whole
    assert f"lost: link.tlog: {len(LOST)} messages of 1.1 never arrived" in done.stderr
    return folder


@pytest.mark.parametrize(
    "words",
    [
        ("ls", "data"),
        ("fleet", "ls", "data"),
        ("tf", "data", *FIELDS),
        ("step", "data", *FIELDS),
        ("plot", "data", "ATTITUDE.roll", "-o", "plot.svg", "--force"),
        ("export", "data", "ATTITUDE", "-o", "table.csv", "--force"),
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_a_verb_says_what_the_link_lost(words: tuple[str, ...], folder: Path) -> None:
    done = call(*words, cwd=folder)
    assert done.returncode == 0, done.stderr
    [flight] = catalogue(folder / "data")
    assert f"lost: {flight.id}: {WORDS}\n" in done.stderr


def test_a_log_itself_is_counted_in_the_same_way(folder: Path) -> None:
    done = call("tf", "link.tlog", *FIELDS, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert f"lost: link.tlog: {len(LOST)} messages of 1.1 never arrived" in done.stderr


def test_the_report_of_a_fit_says_it(folder: Path) -> None:
    fitted = call_quick("fit", "data", *FIELDS, "-o", "run", cwd=folder)
    assert WORDS in fitted.stderr
    judged = call("validate", "run", cwd=folder)
    assert judged.returncode == 0, judged.stderr
    [page] = (folder / "run").rglob("*.html")
    assert f"lost: {WORDS}" in page.read_text()


READING = (
    ("cut.tlog",),
    ("doctor", "cut.tlog"),
    ("export", "cut.tlog", "--to", "csv", "-o", "export.csv", "--force"),
    ("gains", "cut.tlog"),
    ("ingest", "cut.tlog", "-o", "cut"),
    ("ls", "cut.tlog"),
    ("plot", "cut.tlog", "ATTITUDE.roll", "-o", "cut.svg", "--force"),
    ("recipes", "--for", "cut.tlog"),
    ("review", "cut.tlog"),
    ("show", "cut.tlog"),
    ("spectrum", "cut.tlog", "ATTITUDE.roll"),
    ("step", "cut.tlog", *FIELDS),
    ("tf", "cut.tlog", *FIELDS),
)


@pytest.mark.parametrize("words", READING, ids=lambda words: words[0])
def test_a_verb_that_reads_a_file_that_is_cut_off_exits_with_3(
    words: tuple[str, ...], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    Path("cut.tlog").write_bytes(link_with_losses()[:-7])
    done = CliRunner().invoke(root, words, standalone_mode=False)
    assert done.return_value == ExitCode.LOSSES, done.output
    assert "cut off" in done.output or "the file ends inside a record" in done.output


def test_a_check_that_fails_counts_before_losses(folder: Path) -> None:
    (folder / "cut.tlog").write_bytes(link_with_losses()[:-7])
    done = call("review", "cut.tlog", "--fail-if", "trust.duration > 1", cwd=folder)
    assert done.returncode == ExitCode.CHECK_FAILED, done.stderr
