"""ONNX graphs against the models that they come from, in onnxruntime."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.export.onnx_graph import names_json
from flysid.export.programs import members_of, rest_of
from flysid.export.reference import run
from tests.command import call
from tests.flysid.export.callers import SCRIPT, python_with, require, run_python
from tests.flysid.export.test_callable import BUILDERS, ROWS, file_names, given, measured, model_named
from tests.model_examples import fitted

Found = Mapping[str, FloatArray]
EXPORT = Path(__file__).with_name("export_models.py")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every model, exported by the command and run by onnxruntime."""
    python = require("onnx", "onnxruntime", "flysid.cli.export", "flysid.model.structures", "numba")
    place = tmp_path_factory.mktemp("onnx")
    (place / "models").mkdir()
    for name, file in file_names().items():
        model_named(name).save(place / "models" / f"{file}.json")
        u, weights = given(name)
        np.savez(place / file, u=u.reshape(2, ROWS, -1), weights=weights, measured=measured(name))
    run_python(python, EXPORT, place, cwd=place, knows_flysid=True)
    run_python(python, SCRIPT, "onnx", place, cwd=place)
    return place


@pytest.mark.parametrize("name", BUILDERS)
def test_a_batch_of_free_runs_from_rest_equals_the_model_to_float32(name: str, folder: Path) -> None:
    model = model_named(name)
    u, _ = given(name)
    found = np.load(folder / f"{file_names()[name]}.onnx.npz")
    for inputs, y in zip(u.reshape(2, ROWS, -1), found["y"], strict=True):
        free = model.simulate(inputs)
        size = np.abs(free).max(axis=0) + free.std(axis=0)
        assert (np.abs(y - free).max(axis=0) <= 1e-5 * size).all()


@pytest.mark.parametrize("name", ["ts", "ensemble", "multirotor, thrust curve"])
def test_the_memory_in_physical_units_is_that_of_the_programs(name: str, folder: Path) -> None:
    u = given(name)[0].reshape(2, ROWS, -1)
    found = np.load(folder / f"{file_names()[name]}.onnx.npz")
    members = members_of(model_named(name))
    for inputs, memory in zip(u, found["memory"], strict=True):
        left = np.concatenate([run(m.program, inputs)[1] for m in members])
        np.testing.assert_allclose(memory, left, rtol=1e-4, atol=1e-4)


def test_the_json_names_every_number(folder: Path) -> None:
    document = json.loads((folder / f"{file_names()['ts']}.json").read_text("utf-8"))
    model = fitted("ts")
    assert [s["name"] for s in document["u"]] == [s.name for s in model.inputs]
    assert [s["name"] for s in document["y"]] == [s.name for s in model.outputs]
    assert [entry["name"] for entry in document["x"]] == ["u(k-1)", "u(k-2)", "y(k-1)", "y(k-2)"]
    rest = [entry["rest"] * entry["scale"] + entry["shift"] for entry in document["x"]]
    np.testing.assert_allclose(rest, rest_of(members_of(model)), atol=1e-12)
    assert document["dt_s"] == model.dt_s
    assert document["float32_loss"] is None
    assert json.loads(names_json(members_of(model), 0.001))["float32_loss"] == 0.001


@pytest.mark.skipif(python_with("onnx") is None, reason="onnx cannot be imported")
def test_onnx_finds_the_graph_valid_and_the_batch_open(folder: Path) -> None:
    python = require("onnx")
    check = (
        "import onnx, sys; m = onnx.load(sys.argv[1]); onnx.checker.check_model(m, full_check=True);"
        "print([d.dim_param for d in m.graph.input[0].type.tensor_type.shape.dim])"
    )
    said = run_python(python, "-c", check, f"{file_names()['ts']}.onnx", cwd=folder)
    assert said.strip() == "['batch', '']"


def test_without_onnx_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    fitted("arx").save(tmp_path / "arx.json")
    done = call("export", "arx.json", "--onnx", "plant.onnx", cwd=tmp_path)
    assert done.returncode == 2
    assert 'pip install "flysid[mpc]"' in done.stderr
    assert not list(tmp_path.glob("plant*"))


def test_neither_of_the_two_files_is_overwritten(tmp_path: Path) -> None:
    fitted("arx").save(tmp_path / "arx.json")
    done = call("export", "arx.json", "--onnx", "arx.onnx", cwd=tmp_path)
    assert done.returncode == 2
    assert "arx.json" in done.stderr
    assert "--force" in done.stderr
