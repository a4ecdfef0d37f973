"""A vehicle in other programs: each target moves as Python does, in the real program where it is there."""

from __future__ import annotations

import json
import runpy
import shutil
import socket
import struct
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from flysid.cli import root
from flysid.errors import UsageError
from flysid.export.vehicles.body import body_of
from flysid.export.vehicles.px4 import sih_parameters
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


def test_a_folder_takes_the_c_of_a_vehicle_as_it_takes_that_of_a_model(folder: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(root, ["export", str(folder), "--c", str(tmp_path / "new" / "c")])
    assert done.exit_code == 0, done.output
    written = tmp_path / "new" / "c" / "vehicle.h"
    assert done.output.split() == [str(written)]
    assert written.read_bytes() == exported(folder, "c", "vehicle.h").read_bytes()
    again = CliRunner().invoke(root, ["export", str(folder), "--c", str(tmp_path / "new" / "c")])
    assert isinstance(again.exception, UsageError)


def test_what_only_a_run_has_is_refused_for_a_vehicle(folder: Path, tmp_path: Path) -> None:
    for more in (["--matlab", "m"], ["--lpv", "m.json"], ["--float32"], ["-c", "roll"], ["--model", "ts"]):
        done = CliRunner().invoke(root, ["export", str(folder), "--c", str(tmp_path / "c"), *more])
        assert isinstance(done.exception, UsageError)
        assert "run's model" in str(done.exception)
        assert not (tmp_path / "c").exists()


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


def test_onnx_steps_a_batch_as_the_module_does(folder: Path) -> None:
    pytest.importorskip("onnx", reason="onnx is not installed")
    runtime = pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
    session = runtime.InferenceSession(exported(folder, "onnx", "vehicle.onnx").read_bytes())
    module = runpy.run_path(str(exported(folder, "jax", "model.py")))
    states = START + 0.05 * np.random.default_rng(3).standard_normal((STEPS, len(START)))
    found = session.run(["x_next"], {"x": states.astype(np.float32), "u": COMMANDS.astype(np.float32)})[0]
    library = module["numpy_library"]()
    wanted = [module["step"](x, u, DT, **library) for x, u in zip(states, COMMANDS, strict=True)]
    assert np.abs(found - wanted).max() < 1e-5


@pytest.mark.parametrize("version", ["2", "3"])
@pytest.mark.parametrize("delay", [0.0, 0.0137, 0.03])
def test_an_fmu_steps_as_simulate_does(
    vehicle: FittedVehicle, tmp_path: Path, delay: float, version: str
) -> None:
    pytest.importorskip("fmpy", reason="FMPy is not installed")
    from fmpy.validation import validate_fmu

    from tests.flysid.export.test_fmu import slave

    theta = vehicle.theta.copy()
    theta[layout.DELAY] = delay
    own = replace(vehicle, theta=theta, zero=1000.0)
    own.save(tmp_path / "vehicle.json")
    path = exported(tmp_path, "fmu", "vehicle.fmu", "--fmi", version)
    assert validate_fmu(str(path)) == []
    simulator = slave(path, tmp_path / "unpacked", dict(enumerate(START[:13], 21)))
    write, read = (
        (simulator.setReal, simulator.getReal)
        if version == "2"
        else (simulator.setFloat64, simulator.getFloat64)
    )
    rng = np.random.default_rng(4)
    commands = 1000.0 + 1000.0 * COMMANDS
    volts = rng.uniform(10.0, 12.0, STEPS)
    wind = np.array([1.0, -2.0, 0.5])
    found = []
    for k in range(STEPS):
        write(list(range(8)), [*commands[k], volts[k], *wind])
        found.append(read(list(range(8, 21))))
        simulator.doStep(k * DT, DT)
    wanted = own.simulate(START[:13], commands, DT, volts, wind)
    assert np.abs(np.array(found) - wanted).max() < 1e-9


def test_jsbsim_flies_the_same(vehicle: FittedVehicle, tmp_path: Path) -> None:
    jsbsim = pytest.importorskip("jsbsim", reason="jsbsim is not installed")
    late = 20
    theta = vehicle.theta.copy()
    theta[layout.DELAY] = 0.001 * late
    replace(vehicle, theta=theta).save(tmp_path / "vehicle.json")
    (tmp_path / "aircraft" / "quad").mkdir(parents=True)
    exported(tmp_path, "jsbsim", "aircraft/quad/quad.xml", "--mass", "0.5", "--arm", "0.12")
    flight = jsbsim.FGFDMExec(str(tmp_path))
    flight.set_debug_level(0)
    flight.set_dt(0.001)
    assert flight.load_model("quad")
    foot = 0.3048
    down = np.array([1.0, -1.0, -1.0])
    turn = Rotation.from_quat(START[[7, 8, 9, 6]])
    angles = Rotation.from_matrix(np.diag(down) @ turn.as_matrix() @ np.diag(down)).as_euler("ZYX")
    begins = {
        "lat-gc-deg": 45.0,
        "h-sl-ft": 1000.0,
        **dict(zip(("psi-true-rad", "theta-rad", "phi-rad"), angles, strict=True)),
        **dict(zip(("u-fps", "v-fps", "w-fps"), down * turn.inv().apply(START[3:6]) / foot, strict=True)),
        **dict(zip(("p-rad_sec", "q-rad_sec", "r-rad_sec"), down * START[10:13], strict=True)),
    }
    for name, value in begins.items():
        flight[f"ic/{name}"] = value
    flight.run_ic()
    module = runpy.run_path(str(exported(tmp_path, "jax", "model.py")))
    x = START.copy()
    x[13:] = 0.0
    rows = range(STEPS * 10)
    for row in rows:
        for i in range(MOTORS):
            flight[f"fcs/motor{i + 1}-cmd-norm"] = COMMANDS[row // 10, i]
        flight.run()
        u = COMMANDS[(row - late) // 10] if row >= late else np.zeros(MOTORS)
        x = module["step"](x, u, 0.001, **module["numpy_library"]())
    speed = [flight[f"velocities/v-{way}-fps"] * foot for way in ("north", "east", "down")]
    rates = [flight[f"velocities/{letter}-rad_sec"] for letter in "pqr"]
    assert np.abs(down * speed - x[3:6]).max() < 0.02
    assert np.abs(down * rates - x[10:13]).max() < 0.05


SIH = {"MASS", "IXX", "IYY", "IZZ", "IXY", "IXZ", "IYZ", "T_MAX", "Q_MAX", "L_ROLL", "L_PITCH", "KDV", "KDW"}
"""Of PX4's documented parameters, behind SIH_."""


def plain(vehicle: FittedVehicle, curve: float, motors: int = MOTORS) -> FittedVehicle:
    """A symmetric frame without trim and lean, drag and damping alike in all axes."""
    theta = np.zeros(layout.count(motors))
    theta[: layout.EFFECTS] = vehicle.theta[: layout.EFFECTS]
    theta[layout.CURVE] = curve
    theta[layout.ROTOR_DRAG : layout.BODY_DRAG] = 0.08
    theta[layout.BODY_DRAG : layout.DAMPING] = 0.0
    theta[layout.DAMPING : layout.LEAN] = 0.3 / np.array([1.0, 1.2, 1.9])
    theta[layout.LEAN : layout.INERTIA] = 0.0
    theta[layout.ARM] = 0.0
    if motors == MOTORS:
        theta[layout.EFFECTS :] = vehicle.theta[layout.EFFECTS :]
    else:
        angles = 2.0 * np.pi * (np.arange(motors) + 0.5) / motors
        yaw = 15.0 * (-1.0) ** np.arange(motors)
        theta[layout.EFFECTS :] = np.concatenate([120.0 * np.sin(angles), -100.0 * np.cos(angles), yaw])
    return replace(vehicle, theta=theta)


def sih_slope(own: dict[str, float], x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Accelerations and angular accelerations by PX4's simulation of a quadrotor; axes forward, left, up."""
    roll = own["SIH_L_ROLL"] * own["SIH_T_MAX"] * (-u[0] + u[1] + u[2] - u[3])
    pitch = -own["SIH_L_PITCH"] * own["SIH_T_MAX"] * (u[0] - u[1] + u[2] - u[3])
    yaw = -own["SIH_Q_MAX"] * (u[0] + u[1] - u[2] - u[3])
    inertia = np.array([own[f"SIH_I{axis}"] for axis in ("XX", "YY", "ZZ")])
    turn = Rotation.from_quat(x[[7, 8, 9, 6]])
    lift = turn.apply([0.0, 0.0, own["SIH_T_MAX"] * u.sum()]) - own["SIH_KDV"] * x[3:6]
    rate = x[10:13]
    torque = np.array([roll, pitch, yaw]) - own["SIH_KDW"] * rate - np.cross(rate, inertia * rate)
    return np.concatenate([lift / own["SIH_MASS"] - [0.0, 0.0, 9.81], torque / inertia])


def test_px4s_simulation_turns_and_lifts_alike(vehicle: FittedVehicle, tmp_path: Path) -> None:
    own = plain(vehicle, 0.0)
    own.save(tmp_path / "vehicle.json")
    text = exported(tmp_path, "px4-sih", "quad.params", "--mass", "0.5", "--arm", "0.12").read_text()
    rows = [line.split("\t") for line in text.splitlines() if not line.startswith("#")]
    found = {name: float(value) for _, _, name, value, _ in rows}
    assert set(found) == {f"SIH_{name}" for name in SIH | {"T_TAU", "VEHICLE_TYPE"}}
    assert all(kind == ("6" if name == "SIH_VEHICLE_TYPE" else "9") for _, _, name, _, kind in rows)
    assert found["SIH_T_TAU"] == pytest.approx(0.04)
    order = [0, 2, 3, 1]  # of the log: front right, rear right, rear left, front left
    share = 9.81 / 4.0 / 5.0
    x = START.copy()
    x[13:] = share
    wanted = slope(own, x, x[13:])
    assert np.abs(sih_slope(found, x, x[13:][order]) - wanted[[3, 4, 5, 10, 11, 12]]).max() < 1e-6
    turned = np.array([0.02, -0.01, 0.03, -0.015])
    turned -= turned.mean()
    x[13:] += turned
    wanted = slope(own, x, x[13:])
    assert np.abs(sih_slope(found, x, x[13:][order]) - wanted[[3, 4, 5, 10, 11, 12]]).max() < 0.02


def test_px4_hovers_a_curved_thrust_at_the_same_command_and_six_motors_are_matched(
    vehicle: FittedVehicle,
) -> None:
    quad = sih_parameters(plain(vehicle, 0.7), 0.5, 0.12)
    share = 9.81 / 4.0 / 5.0
    command = (-0.3 + np.sqrt(0.09 + 4.0 * 0.7 * share)) / 1.4
    assert 4.0 * quad["SIH_T_MAX"] * command == pytest.approx(0.5 * 9.81)
    six = sih_parameters(plain(vehicle, 0.0, 6), 0.5, 0.12)
    assert six["SIH_VEHICLE_TYPE"] == 4
    lever = body_of(plain(vehicle, 0.0, 6), 0.5, 0.12).places[:, 1].max()
    assert six["SIH_L_ROLL"] == pytest.approx(lever)
    with pytest.raises(UsageError, match="four or six"):
        sih_parameters(plain(vehicle, 0.0, 8))


ARDUPILOT = {
    *("mass", "diagonal_size", "refSpd", "refAngle", "refVoltage", "refCurrent", "refAlt", "refTempC"),
    *(
        "maxVoltage",
        "battCapacityAh",
        "refBatRes",
        "propExpo",
        "refRotRate",
        "hoverThrOut",
        "pwmMin",
        "pwmMax",
    ),
    *("spin_min", "spin_max", "slew_max", "disc_area", "mdrag_coef", "moment_inertia", "num_motors"),
}
"""What ArduPilot's SITL reads of a model."""


def ardupilot_slope(model: dict[str, Any], x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Accelerations by ArduPilot's frame model, level flight without climbing; axes forward, left, up."""
    air = 101325.0 / (287.26 * (model["refTempC"] + 273.15))
    weight = model["mass"] * 9.80665
    expo = model["propExpo"]
    full = weight / model["hoverThrOut"] / len(u)
    thrust = full * ((1.0 - expo) * u + expo * u**2)
    places = np.array([model[f"motor{i + 1}_position"] for i in range(len(u))])
    yaws = np.array([model[f"motor{i + 1}_yaw"] for i in range(len(u))])
    torque = np.cross(places, thrust[:, None] * [0.0, 0.0, -1.0]).sum(axis=0)
    torque[2] += (yaws * u * 0.05 * model["diagonal_size"] * thrust).sum()
    down = np.array([1.0, -1.0, -1.0])
    speed = down * x[3:6]
    area = np.sqrt(air * model["disc_area"] / len(u))
    momentum = model["mdrag_coef"] * area * np.sqrt(thrust).sum() * speed * [1.0, 1.0, 0.0]
    angle = np.radians(model["refAngle"])
    lean = np.cos(angle)
    known = lean * model["mdrag_coef"] * model["refSpd"] * lean
    known *= np.sqrt(weight / lean * air * model["disc_area"])
    drag = max(weight * np.tan(angle) - known, 0.0) / model["refSpd"] ** 2 * speed * np.abs(speed)
    force = np.array([0.0, 0.0, -thrust.sum()]) - momentum - drag
    turned = torque / np.array(model["moment_inertia"])
    if model["refRotRate"] > 0.0:
        turned -= down * x[10:13] * np.radians(400.0) / model["refRotRate"]
    return np.concatenate([down * force / model["mass"] - [0.0, 0.0, 9.81], down * turned])


def test_ardupilots_frame_turns_lifts_and_drags_alike(vehicle: FittedVehicle, tmp_path: Path) -> None:
    own = plain(vehicle, 0.7)
    own.theta[layout.BODY_DRAG : layout.BODY_DRAG + 2] = 0.02
    own.theta[layout.DAMPING : layout.LEAN] = 0.3
    replace(own, zero=1100.0, full=850.0).save(tmp_path / "vehicle.json")
    out = exported(tmp_path, "ardupilot", "quad.json", "--mass", "0.5", "--arm", "0.12")
    model = json.loads(out.read_text())
    motors = {f"motor{i + 1}_{what}" for i in range(MOTORS) for what in ("position", "yaw")}
    assert set(model) == ARDUPILOT | motors
    assert (model["pwmMin"], model["pwmMax"], model["maxVoltage"]) == (1100.0, 1950.0, 11.1)
    x = START.copy()
    x[3:13] = 4.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.3, -0.2, 0.1
    share = 9.81 / 4.0 / 5.0
    x[13:] = (-0.3 + np.sqrt(0.09 + 4.0 * 0.7 * share)) / 1.4 + 1e-4 * np.array([1.0, -2.0, 2.5, -1.5])
    found = ardupilot_slope(model, x, x[13:])
    wanted = slope(own, x, x[13:])[[3, 4, 5, 10, 11, 12]]
    theta = own.theta
    couple = np.array([theta[layout.INERTIA] - theta[layout.INERTIA + 1], 0.0, 0.0]) * -0.2 * 0.1
    assert np.abs(found[:3] - wanted[:3]).max() < 5e-3
    assert np.abs(found[3:5] - wanted[3:5]).max() < 0.1 + np.abs(couple).max()
    assert found[5] == pytest.approx(wanted[5], abs=0.02)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
def test_betaflights_vehicle_answers_the_firmware(folder: Path, tmp_path: Path) -> None:
    source = exported(folder, "betaflight", "vehicle_betaflight.c")
    built = ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", str(source), "-o", "fly", "-lm"]
    subprocess.run(built, cwd=tmp_path, check=True, capture_output=True, timeout=60)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as state,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as motors,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free,
    ):
        for own in (state, free):
            own.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        free.close()
        state.settimeout(20.0)
        process = subprocess.Popen([tmp_path / "fly", "127.0.0.1", str(port), str(state.getsockname()[1])])
        try:
            rows: list[tuple[float, ...]] = []
            while len(rows) < 20_000 and (not rows or rows[-1][16] < 0.5):
                rows.append(struct.unpack("<18d", state.recv(1024)))
                motors.sendto(struct.pack("<4f", 0.9, 0.9, 0.9, 0.9), ("127.0.0.1", port))
        finally:
            process.kill()
            process.wait()
    assert rows[-1][16] >= 0.5
    assert rows[0][6] == pytest.approx(-9.81)  # it stands on the ground
    thrust = 5.0 * 4.0 * (0.3 * 0.9 + 0.7 * 0.81)
    assert -rows[-1][6] == pytest.approx(thrust, abs=2.0)
    assert rows[-1][1] > 0.0  # trim rolls it to the right
    assert rows[-1][2] > 0.0  # and forward: about right, as the firmware has it


@pytest.mark.parametrize("target", ["px4-sih", "ardupilot"])
def test_what_cannot_hover_goes_into_no_simulator(
    vehicle: FittedVehicle, tmp_path: Path, target: str
) -> None:
    theta = vehicle.theta.copy()
    theta[layout.THRUST] = 2.0
    replace(vehicle, theta=theta).save(tmp_path / "vehicle.json")
    done: Any = CliRunner().invoke(root, ["export", str(tmp_path), "--to", target])
    assert isinstance(done.exception, UsageError)
    assert "does not lift its weight" in str(done.exception)


def test_options_of_models_name_a_vehicles_file_too(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "model.py"
    done = CliRunner().invoke(root, ["export", str(folder), "--casadi", str(out)], catch_exceptions=False)
    assert done.exit_code == 0
    assert "casadi_function" in out.read_text()


@pytest.mark.parametrize(
    ("change", "words"),
    [(lambda f: ["export", f, "--to", "csv", "--mass", "2"], "of a vehicle")],
)
def test_what_makes_no_sense_is_refused(folder: Path, change: Callable[[str], list[str]], words: str) -> None:
    done: Any = CliRunner().invoke(root, change(str(folder)))
    assert isinstance(done.exception, UsageError)
    assert words in str(done.exception)
