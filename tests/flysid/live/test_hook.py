"""`watch --exec`: the user's command, whatever it does with what it is given."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

from flysid.cli.watch import call
from flysid.live.watching import Notice

LONG = "x" * (1 << 20)
"""More than a pipe holds: who does not read it closes it."""


@pytest.mark.filterwarnings("ignore:subprocess .* is still running:ResourceWarning")
@pytest.mark.parametrize("code", ["0", "1", "__import__('sys').stdin.close()"])
def test_a_command_that_ignores_its_input_has_not_failed(
    code: str, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f'{sys.executable} -c "{code}"', Notice("alarm", "roll", "p", 1.0, text=LONG))
    assert capsys.readouterr().err == ""


def test_a_command_that_is_not_there_has(capsys: pytest.CaptureFixture[str]) -> None:
    call("no-such-command", Notice("alarm", "roll", "p", 1.0))
    assert "--exec 'no-such-command' could not be run" in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore:subprocess .* is still running:ResourceWarning")
def test_the_command_runs_in_the_environment_of_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from flysid.surroundings import keep_working_folder_out

    monkeypatch.setattr(sys, "path", list(sys.path))
    for name in ("PYTHONSAFEPATH", "FLYSID_KEEPS_FOLDER_OUT"):
        monkeypatch.setenv(name, "")  # and is as before when the test is over
    keep_working_folder_out()
    out = tmp_path / "out"
    call(f"sh -c 'env > {out}; cat >> {out}'", Notice("alarm", "roll", "p", 1.0))
    until = time.monotonic() + 30
    while not (out.exists() and "alarm" in out.read_text()) and time.monotonic() < until:
        time.sleep(0.05)
    assert "PYTHONSAFEPATH" not in out.read_text()
    assert '"kind": "alarm"' in out.read_text()
