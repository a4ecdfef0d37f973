"""Models in linear parameter-varying form, for every structure: the same outputs; JSON and .mat."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import control
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import loadmat

from flysid.cli.export import command
from flysid.errors import UsageError
from flysid.export.lpv import Lpv, from_dict, to_lpv
from flysid.export.programs import program_of
from flysid.export.reference import run
from flysid.model.base import Fitted
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.narx.fitted_polynomial import FittedPolyNARX
from tests.flysid.export.test_c import EXPORTED, bent, curved, inputs
from tests.model_examples import fitted

AFFINE = [name for name in EXPORTED if not name.startswith("polynarx")]  # which has products


@pytest.mark.parametrize("name", AFFINE)
def test_the_blend_runs_as_the_model_does(name: str) -> None:
    check_blend(fitted(name))


def test_a_polynomial_of_linear_terms_alone_is_affine() -> None:
    model = fitted("polynarx")
    assert isinstance(model, FittedPolyNARX)
    kept = [i for i, term in enumerate(model.terms) if term.is_linear]
    check_blend(
        replace(
            model,
            terms=tuple(model.terms[i] for i in kept),
            theta=model.theta[kept],
            covariance=model.covariance[np.ix_(kept, kept)],
        )
    )


def check_blend(model: Fitted) -> None:
    try:
        program = program_of(model)
        lpv = to_lpv(model)
    except UsageError:
        program = program_of(model, 50.0)
        lpv = to_lpv(model, 50.0)
    u = inputs(model, 400)
    expected, _ = run(program, u)
    size = np.abs(expected).max()
    assert lpv.simulate(u) == pytest.approx(expected, abs=1e-8 * size)
    again = from_dict(json.loads(lpv.to_json()))
    assert again.simulate(u) == pytest.approx(lpv.simulate(u), abs=1e-12 * size)
    mat = loadmat(io.BytesIO(lpv.to_mat()))
    stacked = mat["D"] if mat["D"].ndim == 3 else mat["D"][..., None]
    assert np.array_equal(np.moveaxis(stacked, -1, 0).reshape(lpv.D.shape), lpv.D)


def _dynamic() -> Lpv:
    return next(found for n in AFFINE if len((found := to_lpv(fitted(n))).A) > 1 and len(found.x0))


def test_weights_sum_to_one_and_far_outside_too() -> None:
    lpv = _dynamic()
    for size in (0.0, 1.0, 1e6):
        w = lpv.weights(size * np.ones(len(lpv.P)))
        assert w.sum() == pytest.approx(1.0)
        assert (w >= 0.0).all()


@pytest.mark.parametrize("made", [partial(curved, "rate"), bent], ids=["thrust curve", "terms"])
def test_products_are_no_affine_system(made: Callable[[], Fitted]) -> None:
    with pytest.raises(UsageError, match="products, magnitudes or signs of signals"):
        to_lpv(made())


def test_several_systems_are_no_linear_one() -> None:
    with pytest.raises(UsageError, match="not one linear"):
        _dynamic().to_control()


@pytest.mark.parametrize("name", ["arx", "oe"])
def test_a_linear_model_keeps_its_offsets_in_python_control(name: str) -> None:
    model = fitted(name)
    assert isinstance(model, FittedLinear)
    lpv = to_lpv(model)
    u = inputs(model, 300)
    driven = np.column_stack([u, np.ones(len(u))]).T
    there = control.forced_response(lpv.to_control(), inputs=driven, X0=lpv.x0)
    y = np.atleast_2d(np.asarray(there.outputs)).T
    assert y == pytest.approx(model.simulate(u), abs=1e-9 * np.abs(y).max())
    own = model.to_control("ss", offsets=True)
    assert list(own.input_labels) == [*(s.name for s in model.inputs), "one"]
    alone = np.atleast_2d(np.asarray(control.forced_response(own, inputs=driven).outputs)).T
    assert alone == pytest.approx(model.simulate(u), abs=1e-9 * np.abs(y).max())


def test_the_command_writes_both_forms_and_no_other(tmp_path: Path) -> None:
    file = tmp_path / "arx.json"
    fitted("arx").save(file)
    for name in ("lpv.json", "lpv.mat"):
        done = CliRunner().invoke(command, [str(file), "--lpv", str(tmp_path / name)], standalone_mode=False)
        assert done.exception is None
    told = json.loads((tmp_path / "lpv.json").read_text("utf-8"))
    assert from_dict(told).A.shape == to_lpv(fitted("arx")).A.shape
    assert loadmat(tmp_path / "lpv.mat")["dt_s"].item() == fitted("arx").dt_s
    done = CliRunner().invoke(command, [str(file), "--lpv", str(tmp_path / "lpv.txt")], standalone_mode=False)
    assert isinstance(done.exception, UsageError)
