"""Exported C against the models that it comes from: compiled and run, for every structure."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import UsageError
from flysid.export.csource import c_files, identifier
from flysid.export.from_linear import linear_program
from flysid.export.programs import program_of
from flysid.export.reference import run
from flysid.export.single import loss_in_float32, refuse_poles
from flysid.model.base import Fitted
from flysid.model.freerun import Difference
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.multirotor import FittedMultirotor, Kind, Multirotor
from flysid.model.narx.fitted_polynomial import FittedPolyNARX, Units
from flysid.model.narx.polynomial_terms import Factor, SeenRange, Term
from flysid.model.oe import OE
from flysid.model.rotorcraft.rotor_axis import CURVE, DAMPING, DELAY, LAG
from flysid.model.static_ts import StaticTS
from flysid.model.transfer_function import FittedTF
from tests.flysid.export.compiled import WARNINGS, gcc, needs_gcc, run_in_c, write_c
from tests.model_examples import EXAMPLES, fitted

REFUSED = ("ensemble",)  # the mean of several models has no single step
EXPORTED = [name for name in EXAMPLES if not name.startswith(REFUSED)]
TO_THE_BIT = [name for name in EXPORTED if name.startswith(("ts", "polynarx"))]


def inputs(model: Fitted, rows: int, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-1.3, 1.7, (rows // 5, len(model.inputs))), 5, axis=0)


def curved(kind: Kind, delay_rows: float = 1.3) -> FittedMultirotor:
    """A physical model of two motors and two outputs whose thrust is bent."""
    data = EXAMPLES["multirotor, accelerations"][1]
    lifted = replace(data, segments=tuple(replace(s, u=s.u - s.u.min(axis=0)) for s in data.segments))
    model = Multirotor(kind=kind, curve=True).fit(lifted)
    axes = []
    for axis in model.axes:
        theta = axis.theta.copy()
        theta[[LAG, DELAY, CURVE]] = 2.0 * model.dt_s, delay_rows * model.dt_s, 0.6
        if kind == "rate":
            theta[DAMPING] = 0.1 / model.dt_s
        axes.append(replace(axis, theta=theta))
    far = np.array([[-1e6], [1e6]]) * np.ones(2)
    return replace(model, axes=tuple(axes), output_limits=far)


def bent() -> FittedPolyNARX:
    """Drag, dry friction, a hardening spring, an input that acts more at speed; about a mean.

    It was trained in a narrow range, so that runs go along its tangents.
    """
    template = fitted("polynarx, two inputs and outputs")
    assert isinstance(template, FittedPolyNARX)
    y = Factor(0, 1)
    speed = Factor(0, 1, change=True)
    size = Factor(0, 1, change=True, form="magnitude")
    terms = (
        *(Term(0, (f,)) for f in (y, speed, Factor(0, 1, change=True, form="sign"), Factor(2, 1))),
        *(Term(0, f) for f in ((), (y, y, y), (size, speed), (y, Factor(3, 2)))),
        *(Term(1, (f,)) for f in (Factor(1, 1), Factor(3, 0, form="magnitude"), Factor(0, 2, form="sign"))),
        Term(1, (Factor(0, 1, form="magnitude"), Factor(1, 2), Factor(2, 0))),
    )
    theta = np.array([0.9, 0.3, -0.01, 0.1, 0.02, -0.02, -0.2, 0.05, 0.8, 0.1, 0.03, -0.1])
    units = Units(np.array([0.0, 0.3, 0.1, 0.0]), np.array([0.7, 0.4, 1.1, 0.9]), 2)
    unknown = np.full((len(terms), len(terms)), np.nan)
    seen = SeenRange(np.outer([-0.4, 0.5], np.ones(4)), np.outer([-0.1, 0.05], np.ones(4)))
    return replace(template, terms=terms, theta=theta, covariance=unknown, units=units, seen=seen)


def linear(a: list[float], b: list[float], *, dt_s: float = 0.02, limit: float = 1e6) -> FittedLinear:
    """A known difference equation of one input and output."""
    template = fitted("arx")
    assert isinstance(template, FittedLinear)
    system = Difference(np.array(a)[:, None, None], np.array(b)[:, None, None], np.zeros(1))
    still = np.zeros(1)
    limits = np.array([[-limit], [limit]])
    return replace(
        template, system=system, u_origin=still, y_origin=still, output_limits=limits, dt_s=dt_s, starts=None
    )


@needs_gcc
@pytest.mark.parametrize("name", ["ts", "ts_ss"])
def test_rules_in_c_without_optimisation_equal_the_free_run_to_the_last_bit(
    name: str, tmp_path: Path
) -> None:
    model = fitted(name)
    u = inputs(model, 20_000)
    assert np.array_equal(run_in_c(program_of(model), u, tmp_path, ("-O0",)), model.simulate(u))


@needs_gcc
@pytest.mark.parametrize("name", EXPORTED)
def test_every_structure_in_c_equals_its_program_exactly_and_the_model_closely(
    name: str, tmp_path: Path
) -> None:
    model = fitted(name)
    program = program_of(model)
    u = inputs(model, 1_000)
    found = run_in_c(program, u, tmp_path / "double")
    assert np.array_equal(found, run(program, u)[0])
    free = model.simulate(u)
    np.testing.assert_allclose(found, free, rtol=0.0, atol=0.0 if name in TO_THE_BIT else 1e-12)
    told = run(program, u, single=True)[0]
    size = np.std(told, axis=0) + np.abs(told).max(axis=0)
    single = run_in_c(program, u, tmp_path / "single", single=True)
    assert (np.abs(single - told).max(axis=0) <= 1e-5 * size).all()


@needs_gcc
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("name", ["ts", "oe", "static ts"])
def test_the_self_test_passes_and_fails_where_one_number_is_wrong(
    name: str, single: bool, tmp_path: Path
) -> None:
    folder = write_c(program_of(fitted(name)), tmp_path, single=single)
    source = folder / "plant.c"
    check = folder / "check"
    arguments = (*WARNINGS, "-O2", "-o", check, source, folder / "check.c", "-lm")
    gcc(*arguments)
    assert subprocess.run([check], check=False, capture_output=True).returncode == 0
    text = source.read_text()
    assert "y_shift[i]" in text
    source.write_text(text.replace("+ y_shift[i]", f"+ (y_shift[i] + {'0.01f' if single else '0.01'})"))
    gcc(*arguments)
    assert subprocess.run([check], check=False, capture_output=True).returncode == 1


@needs_gcc
@pytest.mark.parametrize("name", ["ts", "ts_ss", "oe", "statespace, late input", "fir"])
def test_a_run_goes_on_from_the_memory_of_another(name: str, tmp_path: Path) -> None:
    model = fitted(name)
    program = program_of(model)
    u = inputs(model, 1_000)
    _, memory = run(program, u[:400])
    found = run_in_c(program, u[400:], tmp_path, memory=memory)
    np.testing.assert_allclose(found, model.simulate(u)[400:], rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("name", ["ts", "ts_ss", "oe"])
def test_c_is_the_same_each_time(name: str) -> None:
    program = program_of(fitted(name))
    assert c_files(program, "plant") == c_files(program, "plant")


@needs_gcc
@pytest.mark.parametrize("name", ["ts", "oe", "static ts"])
def test_the_code_asks_for_nothing_but_exp_and_keeps_nothing(name: str, tmp_path: Path) -> None:
    folder = write_c(program_of(fitted(name)), tmp_path)
    gcc(*WARNINGS, "-O2", "-c", "-o", folder / "plant.o", folder / "plant.c")
    listed = subprocess.run(["nm", folder / "plant.o"], capture_output=True, text=True, check=True).stdout
    kinds = [line.split()[-2:] for line in listed.splitlines()]
    assert {symbol for kind, symbol in kinds if kind == "U"} <= {"exp"}
    assert not [symbol for kind, symbol in kinds if kind in "bBdDC"]  # no variables outside functions


@pytest.mark.skipif(shutil.which("cppcheck") is None, reason="cppcheck is not installed")
@pytest.mark.parametrize("name", ["ts", "oe", "static ts, two inputs and outputs"])
def test_cppcheck_finds_no_required_misra_rule_broken(name: str, tmp_path: Path) -> None:
    """8.7 (a function that only one file uses) is advisory, and what an interface is."""
    folder = write_c(program_of(fitted(name)), tmp_path)
    options = ["--addon=misra", "--std=c99", "--enable=style", "--suppress=missingIncludeSystem"]
    done = subprocess.run(
        ["cppcheck", *options, "--suppress=misra-c2012-8.7", "--error-exitcode=1", folder / "plant.c"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@needs_gcc
@pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not installed")
def test_cmake_builds_it_and_runs_its_self_test(tmp_path: Path) -> None:
    folder = write_c(program_of(fitted("ts")), tmp_path)
    commands: list[list[str | Path]] = [
        ["cmake", "-S", folder, "-B", tmp_path / "build"],
        ["cmake", "--build", tmp_path / "build"],
        ["ctest", "--test-dir", tmp_path / "build", "--no-tests=error"],
    ]
    for command in commands:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


@needs_gcc
@pytest.mark.parametrize("kind", ["rate", "acceleration"])
@pytest.mark.parametrize("delay_rows", [0.0, 0.4, 1.0, 2.7])
def test_a_thrust_curve_in_c_is_the_free_run(kind: Kind, delay_rows: float, tmp_path: Path) -> None:
    model = curved(kind, delay_rows)
    program = program_of(model)
    assert len(program.worked)
    u = np.abs(inputs(model, 2_000))
    found = run_in_c(program, u, tmp_path / "double")
    assert np.array_equal(found, run(program, u)[0])
    free = model.simulate(u)
    np.testing.assert_allclose(found, free, rtol=0.0, atol=1e-12 * np.abs(free).max())
    told = run(program, u, single=True)[0]
    single = run_in_c(program, u, tmp_path / "single", single=True)
    assert (np.abs(single - told).max(axis=0) <= 1e-5 * np.abs(told).max(axis=0)).all()
    _, memory = run(program, u[:400])
    later = run_in_c(program, u[400:], tmp_path / "later", memory=memory)
    np.testing.assert_allclose(later, free[400:], rtol=0.0, atol=1e-11 * np.abs(free).max())


@needs_gcc
def test_every_kind_of_term_in_c_is_the_free_run_to_the_last_bit(tmp_path: Path) -> None:
    model = bent()
    program = program_of(model)
    assert {w.operation for w in program.worked} == {"change", "magnitude", "sign", "product", "held"}
    u = inputs(model, 20_000)
    free = model.simulate(u)
    assert (free.std(axis=0) > 0.05).all()
    assert np.array_equal(run_in_c(program, u, tmp_path / "double"), free)
    _, memory = run(program, u[:400])
    later = run_in_c(program, u[400:], tmp_path / "later", memory=memory)
    np.testing.assert_allclose(later, free[400:], rtol=0.0, atol=1e-11)
    short = u[:300]
    single = run_in_c(program, short, tmp_path / "single", single=True)
    np.testing.assert_allclose(single, run(program, short, single=True)[0], rtol=0.0, atol=1e-5)


def test_terms_whose_rounded_pole_leaves_the_circle_are_refused_in_float32() -> None:
    """y(k) = (1 + e) y(k-1) + 0.5 (y(k-1) - y(k-2)) with an e < 0 that float32 rounds away."""
    template = fitted("polynarx")
    assert isinstance(template, FittedPolyNARX)
    terms = (Term(0, (Factor(0, 1),)), Term(0, (Factor(0, 1, change=True),)), Term(0, (Factor(1, 1),)))
    model = replace(template, terms=terms, theta=np.array([1.0 - 1e-9, 0.5, 0.1]))
    with pytest.raises(UsageError, match="leaves the unit circle"):
        refuse_poles(program_of(model))
    refuse_poles(program_of(replace(model, theta=np.array([0.99, 0.5, 0.1]))))


# -- linear models ---------------------------------------------------------------------------------------


def test_states_that_nothing_shows_fall_away_and_dead_time_is_no_state() -> None:
    """(1 - 0.5 q)(1 - 0.9 q) y = (1 - 0.5 q) q^3 u: one pole cancels, three samples of dead time."""
    a = np.convolve([1.0, -0.5], [1.0, -0.9])
    model = linear(a.tolist(), [0.0, 0.0, 0.0, 1.0, -0.5])
    program = program_of(model)
    assert program.n == 2  # the output and one state
    u = inputs(model, 500)
    np.testing.assert_allclose(run(program, u)[0], model.simulate(u), atol=1e-12)


@pytest.mark.parametrize("a", [[1.0, -1.0], [1.0, -2.0, 1.0], [1.0, -2.1, 1.15]])
def test_integrators_and_unstable_models_stay_exact_and_end_at_their_limits(a: list[float]) -> None:
    model = linear(a, [0.0, 0.3], limit=50.0)
    program = program_of(model)
    u = inputs(model, 60)
    np.testing.assert_allclose(run(program, u)[0], model.simulate(u), atol=1e-9)
    long = np.ones((5_000, 1))
    assert (np.abs(run(program, long)[0]) <= 50.0).all()
    assert np.isfinite(run(program, long, single=True)[0]).all()


def test_fast_sampling_of_order_four_survives_float32_in_balanced_states() -> None:
    """In lags these coefficients, rounded to float32, have poles outside the unit circle."""
    a = np.poly([0.999, 0.998, 0.997 + 0.002j, 0.997 - 0.002j]).real
    assert np.abs(np.roots(a.astype(np.float32))).max() > 1.0
    model = linear(a.tolist(), [0.0, a.sum()])
    u = inputs(model, 20_000)
    program = program_of(model)
    double = run(program, u)[0]
    single = run(program, u, single=True)[0]
    assert np.sqrt(np.mean((double - single) ** 2)) < 1e-3 * np.std(double)


def test_a_transfer_function_runs_at_another_rate() -> None:
    model = fitted("tf, two inputs and outputs")
    assert isinstance(model, FittedTF)
    fast = program_of(model, 4.0 / model.dt_s)
    u = np.repeat(inputs(model, 400), 1, axis=0)
    slow = run(program_of(model), u)[0]
    found = run(fast, np.repeat(u, 4, axis=0))[0]
    # held through four steps, sampled every fourth: the same transfer functions see the same inputs
    np.testing.assert_allclose(found[::4][200:], slow[200:], atol=2e-3 * np.ptp(slow))


def test_another_rate_is_for_transfer_functions() -> None:
    with pytest.raises(UsageError, match="runs at 50 Hz only"):
        program_of(fitted("arx"), 10.0)
    with pytest.raises(UsageError, match="rate of nan"):
        program_of(fitted("tf"), float("nan"))


# -- refusals --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_recursion_to_write_is_refused_with_what_to_do(name: str) -> None:
    with pytest.raises(UsageError, match="cannot be exported"):
        program_of(fitted(name))


def _in_lags(model: FittedLinear) -> object:
    """The program as a naive exporter would write it: over lags, not balanced."""
    plain = linear_program(
        replace(model, system=Difference(model.system.a[:1], model.system.b, model.system.c))
    )
    depth = len(model.system.a) - 1
    column = np.concatenate([np.zeros(depth, dtype=np.int64), plain.lags.column])
    lag = np.concatenate([np.arange(1, depth + 1), plain.lags.lag])
    theta = np.concatenate([-model.system.a[None, 1:, :, 0].transpose(0, 2, 1), plain.theta], axis=2)
    rest = np.zeros((2, depth + 1))
    return replace(plain, lags=plain.lags._replace(column=column, lag=lag), theta=theta, rest=rest)


def test_float32_is_refused_where_a_rounded_pole_leaves_the_circle() -> None:
    a = np.poly([0.999, 0.998, 0.997 + 0.002j, 0.997 - 0.002j]).real
    model = linear(a.tolist(), [0.0, a.sum()])
    with pytest.raises(UsageError, match="leaves the unit circle") as caught:
        refuse_poles(_in_lags(model))  # type: ignore[arg-type]
    assert "double" in caught.value.hint
    refuse_poles(program_of(model))


def test_float32_is_refused_where_it_costs_more_than_a_hundredth_of_the_error() -> None:
    rng = np.random.default_rng(3)
    a = np.poly([0.99, 0.98, 0.97, 0.96]).real
    model = linear(a.tolist(), [0.0, a.sum()])
    u = [np.repeat(rng.uniform(-1, 1, (80, 1)), 25, axis=0) for _ in range(2)]
    y = [model.simulate(x) + 0.01 * rng.standard_normal((len(x), 1)) for x in u]
    train = Dataset.from_arrays(u, y, model.dt_s)
    assert loss_in_float32(model, program_of(model), train) < 0.01
    with pytest.raises(UsageError, match="strays by"):
        loss_in_float32(model, _in_lags(model), train)  # type: ignore[arg-type]


# -- names -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("channel", "name"),
    [("Roll rate", "roll_rate"), ("1", "model_1"), ("", "model"), ("/*;}", "model"), ("α", "model")],
)
def test_channels_become_names_that_c_takes(channel: str, name: str) -> None:
    assert identifier(channel) == name


@needs_gcc
def test_names_from_logs_do_not_end_comments(tmp_path: Path) -> None:
    data = EXAMPLES["static ts"][1]
    hostile = Signal("a*/ int x; /*\n#include <nothing.h>", "*/")
    renamed = replace(data, inputs=(hostile,), outputs=(hostile,))
    program = program_of(StaticTS(rules=2).fit(renamed))
    u = np.zeros((3, 1))
    assert run_in_c(program, u, tmp_path).shape == (3, 1)


def test_oe_is_balanced_and_small() -> None:
    model = OE(na=2, nb=2, nk=1).fit(EXAMPLES["oe"][1])
    assert program_of(model).n == 3
