"""The `flysid` command in the test's own process: what it writes, and its exit code, as in a shell.

A process of its own costs a second or two of imports. `shell` starts one, for the few claims that need it.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from flysid.cli import main
from flysid.validate.runs import fitting
from tests import quick_flysid

ROOT = Path(__file__).resolve().parents[1]
Done = subprocess.CompletedProcess[str]


def call(*args: str | Path, cwd: Path) -> Done:
    """Run flysid in folder `cwd`."""
    words = ["flysid", *map(str, args)]
    with pytest.MonkeyPatch.context() as patch, contextlib.chdir(cwd):
        patch.setattr(sys, "argv", words)
        patch.setenv("PYTHONSAFEPATH", "1")  # the command sets it for the processes that it begins
        patch.setattr(sys, "path", list(sys.path))
        with CliRunner().isolation(env={"NO_COLOR": "1"}) as (out, err, _):
            try:
                main()
            except SystemExit as end:
                code = end.code
            sys.stdout.flush()
            sys.stderr.flush()
    assert isinstance(code, int)
    return Done(words, code, out.getvalue().decode(), err.getvalue().decode())


def call_quick(*args: str | Path, cwd: Path) -> Done:
    """Run flysid in folder `cwd` with three models that take no time to fit."""
    with pytest.MonkeyPatch.context() as patch:
        for name, instead in quick_flysid.INSTEAD.items():
            patch.setattr(fitting, name, instead)
        return call(*args, cwd=cwd)


def shell(*args: str | Path, cwd: Path, **environment: str) -> Done:
    """Run flysid in folder `cwd` in a fresh process."""
    return subprocess.run(
        [sys.executable, "-m", "flysid", *map(str, args)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT), "NO_COLOR": "1"} | environment,
        timeout=120,
    )
