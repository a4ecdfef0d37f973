"""A package outside this repository adds a log format and a model structure, without touching a file here."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import flysid
from tests.fakes import FirstOrder, flown

ROOT = Path(__file__).resolve().parents[2]

PACKAGE = {
    "pingpong/__init__.py": "",
    "pingpong/reader.py": """
import numpy as np
import pyarrow as pa
from flysid.flight import ClockMap, Damage
from flysid.ingest.formats.base import StreamPart, Summary

def sniff(head, name):
    return 1.0 if head.startswith(b"PINGPONG") else 0.0

def read(view, name, limits):
    values = np.frombuffer(bytes(view[8:]), dtype="<f8")
    times = np.arange(len(values), dtype=np.int64) * 20_000_000
    boots = np.zeros(len(values), np.int32)
    yield StreamPart("ball", pa.table({"time_ns": times, "boot": boots, "height": values}))
    return Summary(Damage(), (ClockMap(0, 0, int(times[-1])),), {"autopilot": "none"})
""",
    "pingpong/formats.py": """
from flysid.ingest.formats.base import Format

FORMAT = Format("pingpong", "Ping-pong log", (".ping",), "pingpong.reader")
""",
    "pingpong/models.py": """
from flysid.model.linear import difference_equation

def from_dict(document):
    return difference_equation.from_dict({**document, "structure": "mean"})
""",
    "pingpong-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: pingpong\nVersion: 1.0\n",
    "pingpong-1.0.dist-info/entry_points.txt": (
        "[flysid.formats]\npingpong = pingpong.formats:FORMAT\n"
        "[flysid.structures]\npingpong-mean = pingpong.models:from_dict\n"
    ),
}


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """An environment in which the package is installed, as pip would lay it out."""
    site = tmp_path / "site"
    for name, text in PACKAGE.items():
        path = site / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return {**os.environ, "PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}


def run(environment: dict[str, str], folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments], env=environment, cwd=folder, capture_output=True, text=True, timeout=120
    )


def test_its_logs_are_found_in_folders_and_ingested(installed: dict[str, str], tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    (logs / "a.ping").write_bytes(b"PINGPONG" + bytes(8 * 100))
    done = run(installed, tmp_path, "-m", "flysid", "ingest", "logs", "-o", "data")
    assert done.returncode == 0, done.stderr
    shown = run(installed, tmp_path, "-m", "flysid", "show", "data")
    assert "pingpong" in shown.stdout
    assert "ball" in shown.stdout


def test_models_of_its_structure_are_loaded(installed: dict[str, str], tmp_path: Path) -> None:
    data = flown(FirstOrder(), [200], noise=0.02)
    path = tmp_path / "model.json"
    flysid.Mean().fit(data).save(path)
    document = json.loads(path.read_text())
    path.write_text(json.dumps({**document, "structure": "pingpong-mean"}))
    done = run(installed, tmp_path, "-c", "import flysid; print(flysid.load('model.json').n_parameters)")
    assert done.stdout.strip() == "1", done.stderr


def test_what_is_no_format_is_named(installed: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "site/pingpong/formats.py").write_text("FORMAT = 3\n")
    (tmp_path / "a.ping").write_bytes(b"PINGPONG" + bytes(80))
    done = run(installed, tmp_path, "-m", "flysid", "ingest", "a.ping", "-o", "data")
    assert done.returncode != 0
    assert "'pingpong' of flysid.formats is not a new format" in done.stderr
