"""FMUs as simulators: flysid's own, whose truth is the model that they were made of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import Segment
from flysid.errors import UsageError
from flysid.export.fmu import fmu_bytes
from flysid.export.programs import program_of
from flysid.outside.bring import bring
from flysid.outside.like import Like
from tests.flysid.export.compiled import needs_gcc
from tests.flysid.export.test_c import inputs
from tests.model_examples import fitted

pytest.importorskip("fmpy", reason="FMPy is not installed")
pytestmark = needs_gcc


@pytest.fixture(params=[2, 3])
def fmu(tmp_path: Path, request: pytest.FixtureRequest) -> str:
    path = tmp_path / "plant.fmu"
    path.write_bytes(fmu_bytes(program_of(fitted("ts")), "plant", version=request.param))
    return str(path)


def test_an_fmu_of_a_model_runs_as_the_model_does(fmu: str) -> None:
    truth = fitted("ts")
    model = bring(fmu, Like.of(truth))
    u = inputs(truth, 200)
    assert np.array_equal(model.simulate(u), truth.simulate(u))
    y = truth.simulate(inputs(truth, 260))[60:]
    run = model.free_run(Segment(inputs(truth, 260)[60:], y, 0, "a"))  # type: ignore[attr-defined]
    assert np.abs(run - y)[20:].max() < 0.02 * np.ptp(y)  # its start was fitted, not at rest
    assert "nothing was estimated" in model.notes[0]


def test_other_signals_sample_times_and_files_are_refused(fmu: str, tmp_path: Path) -> None:
    like = Like.of(fitted("ts"))
    with pytest.raises(UsageError, match="the FMU steps by"):
        bring(fmu, replace(like, dt_s=0.3 * like.dt_s))
    with pytest.raises(UsageError, match="no real variable mass"):
        bring(fmu, like, ["mass"])
    (tmp_path / "no.fmu").write_bytes(b"PK")
    with pytest.raises(UsageError, match="not an FMU"):
        bring(str(tmp_path / "no.fmu"), like)
    bare = tmp_path / "bare.fmu"
    bare.write_bytes(fmu_bytes(program_of(fitted("ts")), "plant", binary=False))
    with pytest.raises(UsageError, match="no binary for"):
        bring(str(bare), like)
