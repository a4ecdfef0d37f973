"""`flysid validate RUN --with ...`: models from outside on the held-out flights, see docs/own-models.md."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from flysid.files import write_atomically
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.synth.synth import WRITERS, Order, flights
from flysid.model.arx import ARX
from flysid.model.base import Estimator, load
from flysid.model.oe import OE
from flysid.validate.runs import fitting
from flysid.validate.runs.fitting import fit_run
from flysid.validate.runs.run import FitSettings, Run
from tests.command import ROOT, call

CHANNEL = "longitudinal"
PAGE = (ROOT / "docs" / "own-models.md").read_text("utf-8")
FUNCTION = next(b for b in re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S) if "def simulate" in b)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """ARX and OE of given orders on six flights of 20 s, each left out in turn."""
    root = tmp_path_factory.mktemp("beside")
    for recording in flights(Order(duration_s=20.0)):
        suffix, encode = WRITERS["mcap"]
        write_atomically(root / f"{recording.name}{suffix}", encode(recording))
    list(ingest_logs(find_logs([root]), root / "data"))
    given: dict[str, Estimator] = {"arx": ARX(na=2, nb=2, nk=1, refine=False), "oe": OE(na=1, nb=1, nk=1)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "linear_rivals", lambda *_: given)
        settings = FitSettings(channels=(CHANNEL,), models=("line",))
        return fit_run(open_lake(root / "data"), "ardrone-synthetic", root / "run", settings)


@pytest.fixture
def here(run: Run, tmp_path: Path) -> Iterator[Path]:
    """A folder with the page's function, and OE as MATLAB text; judged, they must score as OE does."""
    (tmp_path / "sim.py").write_text(FUNCTION)
    done = call(
        *("export", run.folder, "-c", CHANNEL, "--model", "oe", "--matlab", tmp_path / "oe-m"), cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    yield tmp_path
    sys.modules.pop("sim", None)


def test_outside_models_are_judged_on_the_same_flights_and_a_copy_scores_as_its_original(
    run: Run, here: Path
) -> None:
    done = call(
        *("validate", run.folder, "-o", here / "report", "--with", "matlab=oe-m/longitudinal_model.m"),
        *("--with", "mine=sim:simulate", "--fail-if", f"{CHANNEL}.free_run.models.mine.rmse > 1e-9"),
        cwd=here,
    )
    assert done.returncode == 4, done.stderr
    document = json.loads((here / "report" / "report.json").read_text())
    free = document["channels"][CHANNEL]["free_run"]
    assert free["models"]["matlab"]["rmse"] == pytest.approx(free["models"]["oe"]["rmse"], rel=2e-3)
    assert free["models"]["mine"]["rmse"] > 1.5 * free["models"]["oe"]["rmse"]  # a guess
    assert free["pairs"]["mine"]["verdict"] == "worse"
    assert free["pairs"]["mine"]["units"] == free["pairs"]["line"]["units"] == 6
    assert "sim:simulate" in document["provenance"][f"{CHANNEL}: mine"]
    page = (here / "report" / "report.html").read_text("utf-8")
    assert "mine" in page
    assert "sim:simulate" in page
    for name in ("mine", "matlab"):
        assert name in done.stdout
    assert {"mine", "matlab"} <= document["channels"][CHANNEL]["10"]["models"].keys()


def test_a_function_is_imported_only_where_it_is_named(run: Run, here: Path) -> None:
    done = call("validate", run.folder, "-o", here / "report", cwd=here)
    assert done.returncode == 0, done.stderr
    assert "sim" not in sys.modules


def test_an_imported_model_is_a_model_file_like_any_other(run: Run, here: Path) -> None:
    out = here / "sim.json"
    done = call("import", "oe-m/longitudinal_model.m", "--run", run.folder, "-o", out, cwd=here)
    assert done.returncode == 0, done.stderr
    u = np.random.default_rng(1).normal(size=(3000, 1))
    theirs = load(run.folder / CHANNEL / "oe.json")
    assert np.allclose(load(out).simulate(u)[2000:], theirs.simulate(u)[2000:], atol=1e-9)
    again = call("validate", run.folder, "-o", here / "report", "--with", f"sim={out}", cwd=here)
    assert again.returncode == 0, again.stderr
    code = call("import", "sim:simulate", "--run", run.folder, "-o", here / "x.json", cwd=here)
    assert "--with LABEL=sim:simulate" in code.stderr


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (("--with", "oe=sim:simulate"), "has a model 'oe' already"),
        (("--with", "sim:simulate"), "is not understood"),
        (("--with", "roll/x=sim:simulate"), "no channel 'roll'"),
        (("--with", "x=sim:gone"), "cannot be imported"),
        (("--with", "x=sim:simulate", "--fail-if", "free_run.models.y.rmse > 1"), "models.y"),
    ],
)
def test_what_is_meant_wrongly_costs_a_second(
    run: Run, here: Path, words: tuple[str, ...], match: str
) -> None:
    done = call("validate", run.folder, "-o", here / "report", *words, cwd=here)
    assert done.returncode in (1, 2)
    assert match in done.stderr
    assert not (here / "report").exists()
