"""A package outside of flysid adds a model structure: an entry point, and no file of flysid is touched."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from flysid.model.rules.search_settings import SearchSettings
from flysid.model.structures import OWN, table
from flysid.offers import import_name
from tests.model_examples import EXAMPLES, fitted

PACKAGE = """
from dataclasses import replace
from flysid.model.linear.difference_equation import from_dict as linear

def rebuild(document):
    return replace(linear({**document, "structure": "line"}), structure="theirs")
"""
READ = """
import sys
from flysid import Dataset
from flysid.model.base import load
from flysid.model.line import Line
import json
import numpy as np
u = np.random.default_rng(0).normal(size=(200, 1))
model = Line().fit(Dataset.from_arrays(u, 2.0 * u, 0.1))
document = {**model.to_dict(), "structure": sys.argv[2]}
with open(sys.argv[1], "w") as stream:
    json.dump(document, stream)
assert (load(sys.argv[1]).simulate(u, u[:0]) == model.simulate(u, u[:0])).all()
print(load(sys.argv[1]).structure)
"""


def _installed(folder: Path, name: str) -> dict[str, str]:
    """The environment in which a package that offers the structure `name` is installed."""
    folder.mkdir()
    (folder / "theirs.py").write_text(PACKAGE)
    info = folder / "theirs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[flysid.structures]\n{name} = theirs:rebuild\n")
    path = os.pathsep.join([str(folder), *filter(None, sys.path)])
    return {**os.environ, "PYTHONPATH": path}


def _run(folder: Path, name: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", READ, str(folder / "model.json"), name]
    return subprocess.run(
        command, env=_installed(folder / "site", name), capture_output=True, text=True, check=False
    )


def test_an_installed_package_adds_a_structure(tmp_path: Path) -> None:
    done = _run(tmp_path, "theirs")
    assert done.stdout.strip() == "theirs", done.stderr


def test_a_name_that_is_taken_is_refused(tmp_path: Path) -> None:
    done = _run(tmp_path, "arx")
    assert "entry point 'arx' of flysid.structures is not a new structure" in done.stderr


def test_what_rows_point_at_is_there() -> None:
    for row in OWN.values():
        for path in (row.rebuild, row.estimator, row.build, row.program, row.pieces):
            assert not path or callable(import_name(path)), (row.name, path)


def test_rows_take_what_their_settings_have() -> None:
    given = {
        "antecedents": "auto",
        "file": None,
        "flight_offsets": False,
        "nk_hint": (2,),
        "nk_least": (1,),
        "rules": 2,
        "seed": 5,
    }
    for row in OWN.values():
        settings = row.settings({**given, "search": SearchSettings()})
        assert callable(settings.fit), row.name
        assert all(
            getattr(settings, name, given.get(name)) == given.get(name) for name in ("seed", "flight_offsets")
        ), row.name


def test_models_of_a_row_are_stored_under_its_name() -> None:
    by_file = {row.file_name: row for row in table().values() if row.rebuild}
    assert len(by_file) == sum(bool(row.rebuild) for row in table().values())
    assert {fitted(name).structure for name in EXAMPLES} == set(by_file)
