"""MATLAB text, run by Octave."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from flysid.export.matlab import matlab_files
from flysid.export.programs import program_of
from flysid.export.reference import run
from tests.flysid.export.test_c import bent, curved, inputs
from tests.model_examples import fitted


@pytest.mark.skipif(shutil.which("octave") is None, reason="Octave is not installed")
def test_octave_equals_the_model_from_rest_and_from_a_memory(tmp_path: Path) -> None:
    names = ["ts", "ts_ss", "oe", "fir", "static ts, two inputs and outputs", "statespace, late input", "tf"]
    models = {name: fitted(name) for name in (*names, "structured", "multirotor")}
    models["multirotor with a thrust curve"] = curved("rate")
    models["terms"] = bent()
    given = {}
    script = ["load('in.mat');"]
    for i, model in enumerate(models.values()):
        for file, text in matlab_files(model, program_of(model), f"m{i}").items():
            (tmp_path / file).write_text(text)
        u = inputs(model, 300)
        given[f"u{i}"] = u
        script.append(f"y{i} = m{i}_simulate(u{i});")
        script.append(f"[a, x] = m{i}_simulate(u{i}(1:100, :));")
        script.append(f"z{i} = [a; m{i}_simulate(u{i}(101:end, :), x)];")
    script.append("save('-v7', 'out.mat');")
    savemat(tmp_path / "in.mat", given)
    (tmp_path / "work.m").write_text("\n".join(script))
    done = subprocess.run(
        ["octave", "--quiet", "--no-gui", "work.m"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = loadmat(tmp_path / "out.mat")
    for i, (name, model) in enumerate(models.items()):
        expected = run(program_of(model), given[f"u{i}"])[0]
        for key in (f"y{i}", f"z{i}"):
            np.testing.assert_allclose(found[key], expected, rtol=0.0, atol=1e-12, err_msg=name)


@pytest.mark.parametrize(
    ("name", "kind"), [("arx", "idpoly(["), ("oe", "idpoly([],"), ("statespace", "idss("), ("tf", "idtf(")]
)
def test_linear_models_are_objects_of_the_toolbox_with_their_offsets(name: str, kind: str) -> None:
    model = fitted(name)
    text = matlab_files(model, program_of(model), "plant")["plant_model.m"]
    assert kind in text
    assert repr(float(model.u_origin[0])) in text  # type: ignore[attr-defined]


def test_rules_have_no_object_of_the_toolbox() -> None:
    model = fitted("ts")
    assert set(matlab_files(model, program_of(model), "plant")) == {"plant_simulate.m"}
