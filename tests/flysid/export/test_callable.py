"""CasADi and JAX files against the models that they come from, run and differentiated by these packages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import FloatArray, Signal
from flysid.export.programs import members_of, rest_of
from flysid.export.pysource import Dialect, python_file
from flysid.export.reference import run
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.likely_start import MeasuredStart
from flysid.model.static_ts import StaticTS
from tests.command import call
from tests.flysid.export.callers import SCRIPT, python_with, require, run_python
from tests.flysid.export.test_c import bent, curved, inputs
from tests.model_examples import EXAMPLES, fitted

Found = Mapping[str, FloatArray]
ROWS = 120
HORIZON = 25
SHAPES = ("gaussian", "triangle", "trapezoid")


def corrected() -> Fitted:
    """Rules whose start is measured and corrected, as version 0.1.0 wrote them."""
    model = fitted("ts")
    assert isinstance(model, FittedTS)
    rows = model.layout.depth
    gain = 0.05 * np.random.default_rng(5).normal(size=(rows, 2 * rows + 1))
    return replace(model, start=MeasuredStart(gain, rows))


def _shaped(shape: str, conjunction: str) -> Fitted:
    data = EXAMPLES["static ts, two inputs and outputs"][1]
    return StaticTS(rules=4, shape=shape, conjunction=conjunction).fit(data)  # type: ignore[arg-type]


BUILDERS: dict[str, Callable[[], Fitted]] = {
    **{name: partial(fitted, name) for name in EXAMPLES},
    "multirotor, thrust curve": lambda: curved("rate"),
    "polynarx, every kind of term": bent,
    "arx, late inputs": lambda: ARX(na=2, nb=2, nk=3, refine=True).fit(EXAMPLES["arx"][1]),
    "arx, late inputs, coupled outputs": lambda: ARX(na=2, nb=2, nk=(4, 1), refine=False).fit(
        EXAMPLES["arx, coupled outputs"][1]
    ),
    "ts, corrected lags": corrected,
    **{
        f"static ts, {shape}, {conjunction}": partial(_shaped, shape, conjunction)
        for shape in SHAPES
        for conjunction in ("product", "minimum")
    },
}
"""One of every structure, and what examples lack: bent thrust, all kinds of terms, all memberships."""


@cache
def model_named(name: str) -> Fitted:
    """Fitted when a test that runs needs it: most machines skip them all."""
    return BUILDERS[name]()


@cache
def given(name: str) -> tuple[FloatArray, FloatArray]:
    """Inputs, and weights of outputs in a cost."""
    model = model_named(name)
    weights = np.random.default_rng(1).normal(size=(HORIZON, len(model.outputs)))
    return inputs(model, 2 * ROWS, seed=7), weights


@cache
def measured(name: str) -> FloatArray:
    """Outputs of the samples that start a run, with noise."""
    model = model_named(name)
    rows = max(model.n_init, 1)
    noise = np.random.default_rng(4).normal(size=(rows, len(model.outputs)))
    return model.simulate(given(name)[0])[:rows] + 0.02 * noise


def file_names() -> dict[str, str]:
    return {name: f"m{number}" for number, name in enumerate(BUILDERS)}


@pytest.fixture(scope="module", params=["casadi", "jax"])
def called(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Found]:
    """What every model answers in the other program, exported by the command."""
    dialect = request.param
    python = require(dialect, "numpy")
    folder = tmp_path_factory.mktemp(dialect)
    for name, file in file_names().items():
        u, weights = given(name)
        model_named(name).save(folder / f"{file}.json")
        done = call("export", f"{file}.json", f"--{dialect}", f"{file}_{dialect}.py", cwd=folder)
        assert done.returncode == 0, done.stderr
        np.savez(folder / file, u=u.reshape(2, ROWS, -1), weights=weights, measured=measured(name))
    run_python(python, SCRIPT, dialect, folder, cwd=folder)
    return {name: dict(np.load(folder / f"{file}.{dialect}.npz")) for name, file in file_names().items()}


def run_all(model: Fitted, u: FloatArray, memory: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The weighed outputs of a model's programs from a memory, and the memory after them."""
    outputs = np.zeros((len(u), len(model.outputs)))
    after = []
    at = 0
    for program, share in members_of(model):
        size = len(program.memory)
        y, left = run(program, u, memory[at : at + size])
        outputs += share * y
        after.append(left)
        at += size
    return outputs, np.concatenate(after)


@pytest.mark.parametrize("name", BUILDERS)
def test_it_equals_the_free_run_from_rest_and_goes_on_from_a_memory(
    name: str, called: dict[str, Found]
) -> None:
    model = model_named(name)
    u, _ = given(name)
    free = model.simulate(u)
    bound = 1e-9 * (1.0 + np.abs(free).max())
    found = called[name]
    np.testing.assert_allclose(found["y"].reshape(free.shape), free, rtol=0.0, atol=bound)
    memory = run_all(model, u[:ROWS], rest_of(members_of(model)))[1]
    np.testing.assert_allclose(found["memory"], memory, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", BUILDERS)
def test_it_goes_on_from_measured_samples_as_the_model_does(name: str, called: dict[str, Found]) -> None:
    model = model_named(name)
    known = measured(name)
    free = model.simulate(given(name)[0][:ROWS], known)[len(known) :]
    np.testing.assert_allclose(called[name]["go_on"], free, rtol=0.0, atol=1e-9 * (1.0 + np.abs(free).max()))


@pytest.mark.parametrize("name", BUILDERS)
def test_gradients_by_inputs_and_memory_are_those_of_the_python_model(
    name: str, called: dict[str, Found]
) -> None:
    """Along random directions: central differences of flysid's own runs."""
    model = model_named(name)
    u, weights = given(name)
    memory = run_all(model, u[:ROWS], rest_of(members_of(model)))[1]
    window = u[ROWS : ROWS + HORIZON]
    found = called[name]
    rng = np.random.default_rng(2)
    step = 1e-6

    def cost(inputs_by: FloatArray, memory_by: FloatArray) -> float:
        return float((run_all(model, window + inputs_by, memory + memory_by)[0] * weights).sum())

    for _ in range(3):
        v = rng.normal(size=window.shape)
        w = rng.normal(size=memory.shape)
        slope = (cost(step * v, step * w) - cost(-step * v, -step * w)) / (2.0 * step)
        exact = float((found["by_u"] * v).sum() + (found["by_x"] * w).sum())
        size = np.linalg.norm(found["by_u"]) + np.linalg.norm(found["by_x"])
        assert abs(slope - exact) <= 1e-6 * size + 1e-8


@pytest.mark.parametrize("dialect", ["casadi", "jax"])
def test_names_from_logs_stay_in_comments_and_texts(dialect: Dialect, tmp_path: Path) -> None:
    hostile = Signal('a"""\nimport nothing\n\\', "'\"\n#")
    data = replace(EXAMPLES["arx"][1], inputs=(hostile,), outputs=(hostile,))
    text = python_file(members_of(EXAMPLES["arx"][0](data)), "plant", dialect)
    compile(text, "plant.py", "exec")
    assert "\nimport nothing" not in text
    if python := python_with(dialect):
        (tmp_path / "plant.py").write_text(text)
        run_python(python, "plant.py", cwd=tmp_path)


@pytest.mark.parametrize("dialect", ["casadi", "jax"])
def test_to_is_the_option_with_a_name_of_its_own(dialect: str, tmp_path: Path) -> None:
    fitted("arx").save(tmp_path / "arx.json")
    assert call("export", "arx.json", "--to", dialect, cwd=tmp_path).stdout.strip() == f"model_{dialect}.py"
    named = call("export", "arx.json", "--to", dialect, "-o", "mine.py", cwd=tmp_path)
    assert named.stdout.strip() == "mine.py"
    option = call("export", "arx.json", f"--{dialect}", "option.py", cwd=tmp_path)
    assert option.returncode == 0
    texts = {(tmp_path / file).read_text() for file in (f"model_{dialect}.py", "mine.py", "option.py")}
    assert len(texts) == 1


def test_a_file_that_python_cannot_import_or_that_is_there_is_refused(tmp_path: Path) -> None:
    fitted("arx").save(tmp_path / "arx.json")
    wrong = call("export", "arx.json", "--casadi", "plant.txt", cwd=tmp_path)
    assert wrong.returncode == 2
    assert "--casadi plant.py" in wrong.stderr
    (tmp_path / "plant.py").write_text("mine")
    there = call("export", "arx.json", "--jax", "plant.py", cwd=tmp_path)
    assert there.returncode == 2
    assert "--force" in there.stderr
    assert (tmp_path / "plant.py").read_text() == "mine"
