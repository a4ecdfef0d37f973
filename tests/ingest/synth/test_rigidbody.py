"""The nonlinear vehicle: equations (8) and (9), conservation, symmetry, linearisation, effects, accuracy."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.dataset import FloatArray
from flysid.errors import DataError, UsageError
from flysid.ingest.synth.quadrotor import INPUTS, STATES, airframe
from flysid.ingest.synth.rigid_body import (
    ALL,
    PAPER,
    STEP_S,
    SimulatedVehicle,
    closed_loop_rates,
    fly_vehicle,
)

DRONE = SimulatedVehicle()
IDEAL = SimulatedVehicle(effects=PAPER)
GYRO = SimulatedVehicle(effects=replace(PAPER, gyroscopic=True))
FRAME = DRONE.airframe


def rigid_body_rates(
    state: npt.ArrayLike,
    rotors_rad_s: npt.ArrayLike,
    vehicle: SimulatedVehicle,
    wind_m_s: npt.ArrayLike = (0, 0, 0),
) -> FloatArray:
    """(12,) time derivative of the paper's twelve states at given rotor speeds: equations (8) and (9).

    Parameters
    ----------
    state : (12,) position, velocity, phi, theta, psi, p, q, r; world x forward, y left, z up.
    rotors_rad_s : (4,) front, left, rear, right.
    wind_m_s : (3,) in world axes.
    """
    x = np.zeros(STATES)
    out = np.zeros(STATES)
    x[:12] = state
    w1, w2, w3, w4 = (float(w) for w in np.asarray(rotors_rad_s))
    air = [float(v) for v in np.asarray(wind_m_s)]
    airframe(x, w1, w2, w3, w4, air[0], air[1], air[2], vehicle.physics().packed(), out)
    return out[:12]


def random_state(seed: int) -> tuple[FloatArray, FloatArray]:
    """A state in the model's range, high above the ground, and rotor speeds."""
    rng = np.random.default_rng(seed)
    scale = [9, 9, 3, 4, 4, 2, 0.6, 0.6, 3, 2, 2, 2]
    state = rng.uniform(-1, 1, 12) * scale + np.eye(12)[2] * 30
    return state, rng.uniform(130, 500, 4)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6))
def test_without_effects_it_is_the_papers_equations(seed: int) -> None:
    state, w = random_state(seed)
    (phi, theta, psi), (ixx, iyy, izz) = state[6:9], FRAME.inertia_kg_m2
    thrust = FRAME.thrust_factor * np.sum(w**2)
    s = np.sin
    c = np.cos
    expected = np.array(
        [
            thrust / FRAME.mass_kg * (c(psi) * s(theta) + c(theta) * s(phi) * s(psi)),
            thrust / FRAME.mass_kg * (s(psi) * s(theta) - c(psi) * c(theta) * s(phi)),
            thrust / FRAME.mass_kg * c(phi) * c(theta) - FRAME.gravity_m_s2,
            FRAME.arm_m * FRAME.thrust_factor * (w[1] ** 2 - w[3] ** 2) / ixx,
            FRAME.arm_m * FRAME.thrust_factor * (w[2] ** 2 - w[0] ** 2) / iyy,
            FRAME.torque_factor * (w[0] ** 2 - w[1] ** 2 + w[2] ** 2 - w[3] ** 2) / izz,
        ]
    )
    got = rigid_body_rates(state, w, IDEAL)
    np.testing.assert_allclose(got[[3, 4, 5, 9, 10, 11]], expected, rtol=1e-12, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([IDEAL, GYRO]))
def test_energy_changes_by_the_work_of_thrust_and_torque_only(seed: int, vehicle: SimulatedVehicle) -> None:
    """Gyroscopic torques do no work; gravity is potential energy."""
    state, w = random_state(seed)
    rate = rigid_body_rates(state, w, vehicle)
    inertia = np.array(FRAME.inertia_kg_m2)
    gain = FRAME.mass_kg * (state[3:6] @ rate[3:6] + FRAME.gravity_m_s2 * rate[2])
    gain += (inertia * state[9:12]) @ rate[9:12]
    force = FRAME.mass_kg * (rigid_body_rates(state, w, IDEAL)[3:6] + FRAME.gravity_m_s2 * np.eye(3)[2])
    torque = inertia * rigid_body_rates(state, w, IDEAL)[9:12]
    assert gain == pytest.approx(force @ state[3:6] + torque @ state[9:12], rel=1e-9, abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6))
def test_drag_takes_energy_from_motion_through_the_air(seed: int) -> None:
    state, w = random_state(seed)
    wind = np.random.default_rng(seed + 1).normal(0, 2, 3)
    draggy = SimulatedVehicle(effects=replace(PAPER, linear_drag=True, quadratic_drag=True))
    drag = rigid_body_rates(state, w, draggy, wind)[3:6] - rigid_body_rates(state, w, IDEAL)[3:6]
    assert drag @ (state[3:6] - wind) < 0


def turned(state: FloatArray, angle: float) -> FloatArray:
    c = np.cos(angle)
    s = np.sin(angle)
    out = state.copy()
    for i in (0, 3):
        out[i], out[i + 1] = c * state[i] - s * state[i + 1], s * state[i] + c * state[i + 1]
    return out


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.floats(-3, 3))
def test_no_heading_is_special(seed: int, angle: float) -> None:
    state, w = random_state(seed)
    rotated = turned(state, angle)
    rotated[8] += angle
    expected = turned(rigid_body_rates(state, w, DRONE), angle)
    np.testing.assert_allclose(rigid_body_rates(rotated, w, DRONE), expected, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_front_and_rear_can_be_exchanged(seed: int) -> None:
    """The body turned by 180 degrees with its rotors renamed is the same vehicle."""
    state, w = random_state(seed)
    flip = np.array([1.0] * 6 + [-1, -1, 1, -1, -1, 1])
    other = flip * state
    other[8] += np.pi
    expected = flip * rigid_body_rates(state, w, DRONE)
    np.testing.assert_allclose(rigid_body_rates(other, w[[2, 3, 0, 1]], DRONE), expected, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_a_mirror_image_flies_as_a_mirror_image(seed: int) -> None:
    """Left and right exchanged: rotors turn the other way round, so their torque and spin change sign."""
    state, w = random_state(seed)
    mirror = np.array([1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1], dtype=float)
    frame = replace(FRAME, torque_factor=-FRAME.torque_factor, rotor_inertia_kg_m2=-FRAME.rotor_inertia_kg_m2)
    expected = mirror * rigid_body_rates(state, w, DRONE)
    got = rigid_body_rates(mirror * state, w[[0, 3, 2, 1]], SimulatedVehicle(airframe=frame))
    np.testing.assert_allclose(got, expected, atol=1e-9)


def test_the_hover_linearisation_is_the_one_derived_by_hand() -> None:
    """At hover: x'' = g theta - d x', y'' = -g phi - d y', z'' = 2 k_F w0 / m sum(dw) - d z', and so on."""
    hover = np.zeros(12)
    w0 = np.full(4, FRAME.hover_rad_s)
    hover[2] = 1e4  # ground effect falls with the square of the height
    (ixx, iyy, izz), g = FRAME.inertia_kg_m2, FRAME.gravity_m_s2
    a = np.zeros((12, 12))
    a[:3, 3:6], a[6:9, 9:12] = np.eye(3), np.eye(3)
    a[3, 7] = g
    a[4, 6] = -g
    a[3:6, 3:6] = -np.diag(FRAME.linear_drag_1_s)
    thrust = 2 * FRAME.thrust_factor * w0[0]
    lever = FRAME.arm_m
    b = np.zeros((12, 4))
    b[5] = thrust / FRAME.mass_kg
    b[9] = np.array([0, 1, 0, -1]) * lever * thrust / ixx
    b[10] = np.array([-1, 0, 1, 0]) * lever * thrust / iyy
    b[11] = np.array([1, -1, 1, -1]) * 2 * FRAME.torque_factor * w0[0] / izz
    np.testing.assert_allclose(rigid_body_rates(hover, w0, DRONE), 0, atol=1e-8)

    def slope(step: FloatArray, on_rotors: bool) -> FloatArray:
        at = [
            rigid_body_rates(hover + s * step, w0, DRONE)
            if not on_rotors
            else rigid_body_rates(hover, w0 + s * step, DRONE)
            for s in (1e-5, -1e-5)
        ]
        return (at[0] - at[1]) / 2e-5

    np.testing.assert_allclose(np.column_stack([slope(e, False) for e in np.eye(12)]), a, atol=1e-5)
    np.testing.assert_allclose(np.column_stack([slope(e, True) for e in np.eye(4)]), b, atol=1e-5)


def lively(seconds: float, period_s: float) -> FloatArray:
    """Commands on all axes, yaw included, well inside the limits of motors and commands."""
    t = np.arange(round(seconds / period_s)) * period_s
    return np.column_stack(
        [6 * np.sin(1.1 * t), 5 * np.sin(0.7 * t + 1), 0.5 * np.sin(1.9 * t), 20 * np.sin(0.5 * t)]
    )


def reference(vehicle: SimulatedVehicle, inputs: FloatArray, period_s: float, x0: FloatArray) -> FloatArray:
    """The same equations by scipy's eighth-order method at a tolerance of 1e-11, piece by piece."""
    from scipy.integrate import solve_ivp

    physics = vehicle.physics().packed()
    x = x0
    for u in inputs:
        x = solve_ivp(
            lambda _, y, u=u: closed_loop_rates(y, u, physics), (0, period_s), x, method="DOP853",
            rtol=1e-11, atol=1e-13,
        ).y[:, -1]  # fmt: skip
    return np.asarray(x)


def test_ten_seconds_agree_with_solve_ivp_to_a_millionth() -> None:
    vehicle = SimulatedVehicle(effects=replace(ALL, delay=False))
    commands = lively(10.0, 0.5)
    inputs = np.zeros((len(commands), INPUTS))
    inputs[:, :4] = commands * [np.pi / 180, np.pi / 180, 1, -np.pi / 180]
    x0 = vehicle.hover()
    expected = reference(vehicle, inputs, 0.5, x0)
    again = np.vstack([commands, np.zeros((1, 4))])
    flown = fly_vehicle(vehicle, again, period_s=0.5, record_s=0.5).states[-1]
    scale = np.abs(fly_vehicle(vehicle, again, period_s=0.5, record_s=STEP_S).states).max(axis=0)
    assert np.abs((flown - expected) / scale).max() < 1e-6


def test_hover_stays_where_it_is() -> None:
    for vehicle in (IDEAL, SimulatedVehicle(effects=replace(ALL, battery_sag=False, ground_effect=False))):
        states = fly_vehicle(vehicle, np.zeros((500, 3))).states
        np.testing.assert_allclose(states[:, :25], np.tile(vehicle.hover()[:25], (500, 1)), atol=1e-9)


def test_signs_are_those_of_the_papers_figure() -> None:
    for column, name in enumerate(("vx", "vy", "vz")):
        commands = np.zeros((300, 3))
        commands[:, column] = [3.0, 3.0, 0.5][column]
        series = fly_vehicle(DRONE, commands).series()
        assert series[name][-1] > 0.2
        if column < 2:
            assert series[("theta", "phi")[column]][-1] > 0.5
    turn = np.zeros((300, 4))
    turn[:, 3] = 20.0
    assert fly_vehicle(DRONE, turn).series()["psi"][-1] == pytest.approx(20.0 * 6.0, rel=0.1)


def step_to(theta: float = 0.0, vz: float = 0.0, n: int = 250) -> FloatArray:
    commands = np.zeros((n, 3))
    commands[:, 0] = theta
    commands[:, 2] = vz
    return commands


@pytest.mark.parametrize("effect", [f.name for f in fields(ALL)])
def test_every_effect_can_be_switched_and_matters(effect: str) -> None:
    start = DRONE.hover(0.3)
    without = replace(DRONE, effects=replace(ALL, **{effect: False}))
    commands = np.vstack([step_to(20.0, 0.3), step_to(-20.0, -0.05)])
    commands = np.column_stack([commands, np.full(len(commands), 60.0)])
    if effect == "motor_limits":
        commands[:, 2] = np.where(np.arange(len(commands)) % 100 < 50, 40.0, -1.0)
    both = [
        fly_vehicle(v, commands, start=start).states
        for v in (
            replace(DRONE, effects=replace(ALL, command_limits=effect == "command_limits")),
            replace(without, effects=replace(without.effects, command_limits=False)),
        )
    ]
    assert np.abs(both[0][:, :12] - both[1][:, :12]).max() > 1e-3


def test_tilt_costs_altitude_unless_thrust_is_raised() -> None:
    drop = fly_vehicle(DRONE, step_to(12.0)).series()["vz"].min()
    held = fly_vehicle(replace(DRONE, effects=replace(ALL, altitude_drop=False)), step_to(12.0))
    assert drop < -0.02
    assert held.series()["vz"].min() > 0.2 * drop


def test_the_ground_lifts() -> None:
    w0 = np.full(4, FRAME.hover_rad_s)
    lift = [rigid_body_rates(np.eye(12)[2] * h, w0, DRONE)[5] for h in (0.1, 0.2, 0.5, 5.0)]
    assert lift == sorted(lift, reverse=True)
    # Cheeseman and Bennett at one radius: 1 / (1 - 1/16)
    assert lift[0] == pytest.approx(FRAME.gravity_m_s2 * (16 / 15 - 1))


def test_a_late_command_acts_late_and_the_same() -> None:
    commands = step_to(5.0)
    prompt = fly_vehicle(replace(DRONE, effects=replace(ALL, delay=False)), commands).states
    late = fly_vehicle(replace(DRONE, delay_s=0.1), commands).states
    np.testing.assert_allclose(late[5:, 3], prompt[:-5, 3], atol=1e-4)


def test_wind_carries_the_vehicle_along() -> None:
    wind = np.tile([0.0, 2.0, 0.0], (500, 1))
    assert fly_vehicle(DRONE, np.zeros((500, 3)), wind_m_s=wind).states[-1, 4] > 0.2


def test_gain_depends_on_the_amplitude() -> None:
    """Longitudinal: the assist gives out, so fast flight answers with more gain; lateral: drag lowers it."""
    gains = []
    for size in (1.0, 11.0):
        both = np.zeros((1000, 3))
        both[:, 0] = size
        ahead = fly_vehicle(DRONE, both).series()["vx"][-1] / size
        right = fly_vehicle(DRONE, both[:, [1, 0, 2]]).series()["vy"][-1] / size
        gains.append((ahead, right))
    assert gains[1][0] > 1.5 * gains[0][0]
    assert gains[1][1] < 0.9 * gains[0][1]


@pytest.mark.parametrize("commands", [np.zeros((5, 2)), np.zeros(5), np.full((5, 3), np.nan)])
def test_commands_of_the_wrong_kind_are_refused(commands: npt.NDArray[np.float64]) -> None:
    with pytest.raises(UsageError, match="commands must be"):
        fly_vehicle(DRONE, commands)


def test_a_crash_is_named_with_its_time() -> None:
    with pytest.raises(DataError, match="hit the ground") as error:
        fly_vehicle(DRONE, step_to(vz=-1.0), start=DRONE.hover(1.0))
    assert 1.0 < (error.value.flight_time_s or 0) < 3.5
