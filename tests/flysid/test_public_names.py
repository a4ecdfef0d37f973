"""Every public name says what it is and shows an example, and the example does what it says."""

from __future__ import annotations

import doctest
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

import flysid
from flysid.cli import root
from flysid.sixdof import layout
from flysid.sixdof.fitted import FittedVehicle

ROOT = Path(__file__).resolve().parents[2]
NAMES = [name for name in flysid.__all__ if name != "__version__"]
OPTIONS = doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL


@pytest.fixture(scope="module")
def train() -> flysid.Dataset:
    """What the example of `flysid.Dataset` makes."""
    found: dict[str, object] = {"flysid": flysid, "np": np, "lfilter": lfilter}
    (example,) = doctest.DocTestFinder(recurse=False).find(flysid.Dataset, globs=found)
    doctest.DocTestRunner(verbose=False).run(example, clear_globs=False)
    made = example.globs["train"]
    assert isinstance(made, flysid.Dataset)
    return made


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, train: flysid.Dataset) -> Path:
    """The files that examples name: sample logs, a table, an ingested folder."""
    folder = tmp_path_factory.mktemp("examples")
    for name in ("sample_logs", "pyproject.toml"):
        (folder / name).symlink_to(ROOT / name)
    segment = train.segments[0]
    rows = np.column_stack([0.1 * np.arange(len(segment)), segment.u, segment.y])
    np.savetxt(folder / "steps.csv", rows, delimiter=",", header="time,u,y", comments="", fmt="%.6f")
    a_vehicle().save(folder / "vehicle.json")
    log = str(ROOT / "sample_logs/01-steps-seed2.tlog")
    CliRunner().invoke(root, ["ingest", log, "-q", "-o", str(folder / "data")], standalone_mode=False)
    return folder


def a_vehicle() -> FittedVehicle:
    """A vehicle with four motors, of which nothing was determined."""
    theta = np.clip(np.zeros(layout.count(4)), *layout.limits(4))
    size = len(theta)
    none = np.zeros(size, dtype=bool)
    return FittedVehicle(
        theta, np.zeros((size, size)), none, {}, 0.0, 1.0, float("nan"), 0.01, "regression", ()
    )


@pytest.mark.parametrize("name", NAMES)
def test_the_example_does_what_it_says(
    name: str, place: Path, train: flysid.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place)
    known = {"flysid": flysid, "np": np, "lfilter": lfilter, "train": train, name: getattr(flysid, name)}
    (example,) = doctest.DocTestFinder(recurse=False).find(getattr(flysid, name), name, globs=known)
    assert example.examples, f"{name} shows no example"
    said: list[str] = []
    assert doctest.DocTestRunner(optionflags=OPTIONS).run(example, out=said.append).failed == 0, "".join(said)
