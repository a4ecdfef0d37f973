"""Pythons that have the packages which call exported models: this one, or the one in FLYSID_MPC_PYTHON.

Not FLYSID_EXPORT_PYTHON: names that begin with a verb are settings of that verb's options.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.command import ROOT

NAMED = "FLYSID_MPC_PYTHON"
SCRIPT = Path(__file__).with_name("call_models.py")


@cache
def python_with(*packages: str) -> str | None:
    """The path of a Python that can import all of them; None where there is none."""
    if all(importlib.util.find_spec(name) for name in packages):
        return sys.executable
    other = os.environ.get(NAMED)
    if other is None:
        return None
    words = [other, "-c", f"import {', '.join(packages)}"]
    done = subprocess.run(words, capture_output=True, check=False, cwd=ROOT)  # flysid itself is found there
    return other if done.returncode == 0 else None


def require(*packages: str) -> str:
    """`python_with`, or the test is skipped."""
    found = python_with(*packages)
    if found is None:
        names = " and ".join(packages)
        pytest.skip(f"{names} cannot be imported: install, or name another Python in {NAMED}")
    return found


def run_python(python: str, *words: str | Path, cwd: Path, knows_flysid: bool = False) -> str:
    """What a script prints; AssertionError with its complaint where it fails."""
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    if knows_flysid:
        environment["PYTHONPATH"] = str(ROOT)
    done = subprocess.run(
        [python, *map(str, words)], capture_output=True, text=True, check=False, cwd=cwd, env=environment
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
