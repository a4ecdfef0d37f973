"""A vehicle in other programs: each target moves as Python does, in the real program where it is there."""

from __future__ import annotations

import runpy
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli import root
from flysid.errors import UsageError
from flysid.export.vehicles.body import body_of
from flysid.export.vehicles.rotorpy import rotorpy_parameters
from flysid.sixdof import layout
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.rigid_body import run

MOTORS = 4
DT = 0.01
STEPS = 50


@pytest.fixture(scope="module")
def vehicle() -> FittedVehicle:
    """Every number away from zero, without delay, so that a step is one step of the rigid body."""
    theta = np.zeros(layout.count(MOTORS))
    theta[[layout.LAG, layout.CURVE, layout.POWER, layout.THRUST]] = 0.04, 0.7, 1.1, 5.0
    theta[layout.ROTOR_DRAG : layout.TRIM] = 0.08, 0.09, 0.05, 0.01, 0.02, 0.03
    theta[layout.TRIM : layout.INERTIA] = 0.1, -0.2, 0.05, 0.3, 0.2, 0.1, 0.4, -0.5
    theta[layout.INERTIA : layout.EFFECTS] = 1.2, 1.9, 0.001
    signs = np.array([[-1, -1, 1, 1], [-1, 1, 1, -1], [-1, 1, -1, 1]])
    theta[layout.EFFECTS :] = (signs * np.array([[120.0], [100.0], [15.0]])).ravel()
    size = len(theta)
    return FittedVehicle(
        theta, np.zeros((size, size)), np.ones(size, dtype=bool), {}, 0.0, 1000.0, 11.1, DT, "regression", ()
    )


@pytest.fixture(scope="module")
def folder(vehicle: FittedVehicle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("vehicle")
    vehicle.save(place / "vehicle.json")
    return place


def exported(folder: Path, target: str, name: str, *more: str) -> Path:
    out = folder / name
    done = CliRunner().invoke(
        root,
        ["export", str(folder), "--to", target, "-o", str(out), "--force", *more],
        catch_exceptions=False,
    )
    assert done.exit_code == 0, done.output
    return out


START = np.array([0.0, 0.0, 5.0, 1.0, -0.5, 0.3, 0.9, 0.3, -0.2, 0.245, 0.4, -0.3, 0.6, 0.5, 0.6, 0.55, 0.45])
START[6:10] /= np.linalg.norm(START[6:10])
COMMANDS = np.random.default_rng(2).uniform(0.4, 0.7, (STEPS, MOTORS))


def expected(vehicle: FittedVehicle, x: np.ndarray, u: np.ndarray, dt: float) -> np.ndarray:
    """One step of flysid's rigid body, with the motors' exact lag at half steps."""
    lag, curve = vehicle.theta[layout.LAG], vehicle.theta[layout.CURVE]
    times = np.array([0.0, 0.5 * dt, dt])
    motors = u + (x[13:] - u) * np.exp(-times / lag)[:, None]
    share = (1.0 - curve) * motors + curve * motors**2
    return np.concatenate([run(x[:13], share, dt, vehicle.theta)[-1], motors[-1]])


def slope(vehicle: FittedVehicle, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """dx/dt of flysid's rigid body, by its own compiled equations."""
    from flysid.sixdof.rigid_body import _derivative

    curve = vehicle.theta[layout.CURVE]
    share = (1.0 - curve) * x[13:] + curve * x[13:] ** 2
    d, _, _ = _derivative(x[:13], share, np.zeros((0, MOTORS)), vehicle.theta, np.zeros(3), False)
    return np.concatenate([d, (u - x[13:]) / vehicle.theta[layout.LAG]])


def test_the_module_is_the_same_with_numpy(vehicle: FittedVehicle, folder: Path) -> None:
    module = runpy.run_path(str(exported(folder, "jax", "model.py")))
    library = module["numpy_library"]()
    assert (
        np.abs(module["derivative"](START, COMMANDS[0], **library) - slope(vehicle, START, COMMANDS[0])).max()
        < 1e-9
    )
    x = START
    y = START
    for u in COMMANDS:
        for _ in range(20):
            x = module["step"](x, u, DT / 20, **library)
            y = expected(vehicle, y, u, DT / 20)
    assert np.abs(x - y).max() < 1e-6  # two ways to pass a lag through a step


def test_casadi_has_the_same_derivative_and_its_gradient(vehicle: FittedVehicle, folder: Path) -> None:
    casadi = pytest.importorskip("casadi", reason="casadi is not installed")
    function = runpy.run_path(str(exported(folder, "casadi", "casadi_model.py")))["casadi_function"]()
    found = np.asarray(function(START, COMMANDS[0])).ravel()
    assert np.abs(found - slope(vehicle, START, COMMANDS[0])).max() < 1e-9
    x, u = casadi.SX.sym("x", 17), casadi.SX.sym("u", 4)
    gradient = casadi.Function("g", [x, u], [casadi.jacobian(function(x, u), x)])
    by_casadi = np.asarray(gradient(START, COMMANDS[0]))
    step = 1e-6
    for i in range(17):
        moved = step * np.eye(17)[i]
        ends = [slope(vehicle, START + sign * moved, COMMANDS[0]) for sign in (1.0, -1.0)]
        assert np.abs((ends[0] - ends[1]) / (2.0 * step) - by_casadi[:, i]).max() < 1e-6


def test_jax_has_the_same_derivative(vehicle: FittedVehicle, folder: Path) -> None:
    jax = pytest.importorskip("jax", reason="jax is not installed")
    jax.config.update("jax_enable_x64", True)
    module = runpy.run_path(str(exported(folder, "jax", "jax_model.py")))
    found = module["derivative"](
        jax.numpy.array(START), jax.numpy.array(COMMANDS[0]), **module["jax_library"]()
    )
    assert np.abs(np.asarray(found) - slope(vehicle, START, COMMANDS[0])).max() < 1e-9


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
def test_c_moves_as_the_module_does(folder: Path, tmp_path: Path) -> None:
    header = exported(folder, "c", "vehicle.h")
    rows = ", ".join("{" + ", ".join(map(repr, row.tolist())) + "}" for row in COMMANDS)
    (tmp_path / "main.c").write_text(
        f'#include <stdio.h>\n#include "{header}"\nint main(void) {{\n'
        f"  double x[VEHICLE_STATES] = {{{', '.join(map(repr, START.tolist()))}}};\n"
        f"  static const double u[{STEPS}][4] = {{{rows}}}, calm[3] = {{0.0, 0.0, 0.0}};\n"
        f"  for (int i = 0; i < {STEPS}; i++) vehicle_step(x, u[i], calm, {DT});\n"
        '  for (int i = 0; i < VEHICLE_STATES; i++) printf("%.17g\\n", x[i]);\n  return 0;\n}\n'
    )
    built = ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", "main.c", "-o", "fly", "-lm"]
    subprocess.run(built, cwd=tmp_path, check=True, capture_output=True, timeout=60)
    done = subprocess.run([tmp_path / "fly"], check=True, capture_output=True, text=True, timeout=60)
    module = runpy.run_path(str(exported(folder, "jax", "model.py")))
    x = START
    for u in COMMANDS:
        x = module["step"](x, u, DT, **module["numpy_library"]())
    assert np.abs(np.array(done.stdout.split(), dtype=float) - x).max() < 1e-9


def test_rotorpy_flies_the_same(vehicle: FittedVehicle) -> None:
    multirotor = pytest.importorskip("rotorpy.vehicles.multirotor", reason="rotorpy is not installed")
    theta = vehicle.theta.copy()
    theta[layout.CURVE] = 1.0
    theta[layout.ROTOR_DRAG + 1] = theta[layout.ROTOR_DRAG]
    theta[layout.TRIM : layout.INERTIA] = 0.0
    theta[layout.ARM] = 0.0
    own = replace(vehicle, theta=theta)
    parameters = rotorpy_parameters(own, 0.5, 1e-3)  # a short arm: RotorPy damps by the square of its length
    state = {
        "x": START[:3],
        "v": START[3:6],
        "q": START[[7, 8, 9, 6]],
        "w": START[10:13],
        "wind": np.zeros(3),
        "rotor_speeds": 1000.0 * START[13:],
    }
    fine = {"method": "RK45", "rtol": 1e-9, "atol": 1e-11}
    other = multirotor.Multirotor(parameters, state, "cmd_motor_speeds", integrator_kwargs=fine)
    y = START
    for u in COMMANDS:
        state = other.step(state, {"cmd_motor_speeds": 1000.0 * u}, DT)
        for _ in range(5):
            y = expected(own, y, u, DT / 5)
    assert np.abs(state["x"] - y[:3]).max() < 2e-3
    assert np.abs(state["w"] - y[10:13]).max() < 2e-2


def test_rotorpys_file_holds_its_dictionary(vehicle: FittedVehicle, folder: Path) -> None:
    out = exported(folder, "rotorpy", "params.py", "--mass", "0.5", "--arm", "0.12")
    read = runpy.run_path(str(out))["quad_params"]
    assert read.keys() == rotorpy_parameters(vehicle).keys()
    assert read["mass"] == 0.5
    hover = 9.81 * 0.5 / 4.0 / read["k_eta"]
    assert hover == pytest.approx(1000.0**2 * 9.81 / 4.0 / 5.0)


def test_gazebos_model_has_a_plugin_a_motor(folder: Path) -> None:
    model = ElementTree.fromstring(exported(folder, "sdf", "model.sdf", "--mass", "0.5").read_text())
    plugins = model.findall(".//plugin")
    assert [plugin.findtext("motorNumber") for plugin in plugins] == ["0", "1", "2", "3"]
    lift = sum(
        float(p.findtext("motorConstant", "0")) * float(p.findtext("maxRotVelocity", "0")) ** 2
        for p in plugins
    )
    assert lift == pytest.approx(4 * 5.0 * 0.5)
    mass = sum(float(m.text or 0) for m in model.findall(".//mass"))
    assert mass == pytest.approx(0.5)


def test_any_mass_and_arm_turn_alike(vehicle: FittedVehicle) -> None:
    for mass, arm in ((1.0, 0.1), (0.03, 0.046), (8.0, 0.5)):
        body = body_of(vehicle, mass, arm)
        torque = np.stack([body.places[:, 1], -body.places[:, 0]], axis=0) * body.thrust_n
        np.testing.assert_allclose(torque / body.inertia[:2, None], layout.effects(vehicle.theta)[:2])
        assert np.linalg.norm(body.places, axis=1).mean() == pytest.approx(arm)


@pytest.mark.parametrize(
    ("change", "words"),
    [(lambda f: ["export", f, "--to", "csv", "--mass", "2"], "of a vehicle")],
)
def test_what_makes_no_sense_is_refused(folder: Path, change: Callable[[str], list[str]], words: str) -> None:
    done: Any = CliRunner().invoke(root, change(str(folder)))
    assert isinstance(done.exception, UsageError)
    assert words in str(done.exception)
