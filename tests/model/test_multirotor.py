"""The physical model: exact derivatives, known numbers found again, what is not determined is named."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.signal import lfilter

from bench.physical import errors, flown
from flysid.dataset import Dataset, Segment, Signal
from flysid.errors import DataError, UsageError
from flysid.export.programs import program_of
from flysid.ingest.align.recipe import load_recipe
from flysid.model.multirotor import FittedMultirotor, Multirotor, from_dict
from flysid.model.rotorcraft.battery import quieten
from flysid.model.rotorcraft.rotor_axis import NAMES, free_run, predictions


@pytest.fixture(scope="module")
def fitted() -> FittedMultirotor:
    return Multirotor().fit(flown(1, seconds=20.0)[0])


@pytest.mark.parametrize("integrates", [True, False])
def test_derivatives_are_those_of_differences(integrates: bool) -> None:
    rng = np.random.default_rng(0)
    x = np.repeat(rng.uniform(0.2, 1.0, (40, 3)), 10, axis=0)
    y = 0.1 * rng.standard_normal(400).cumsum()
    theta = np.array([0.03, 0.0113, 0.6, 1.2, 0.1, 0.4, 0.05 if integrates else 0.0, 3.0, -2.0, 1.0])
    _, slopes = predictions(x, y, theta, 0.01, integrates)
    for j, step in enumerate(1e-6 * np.eye(len(theta))):
        above = predictions(x, y, theta + step, 0.01, integrates)[0]
        below = predictions(x, y, theta - step, 0.01, integrates)[0]
        np.testing.assert_allclose(slopes[:, j], (above - below) / 2e-6, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("integrates", [True, False])
def test_derivatives_by_what_the_voltage_does_are_those_of_differences(integrates: bool) -> None:
    rng = np.random.default_rng(1)
    x = np.repeat(rng.uniform(0.2, 1.0, (40, 2)), 10, axis=0)
    y = 0.1 * rng.standard_normal(400).cumsum()
    volts = 0.1 * rng.standard_normal(400)
    theta = np.array([0.03, 0.0113, 0.6, 1.2, 0.1, 0.4, 0.05 if integrates else 0.0, 3.0, -2.0, 0.7])
    _, slopes = predictions(x, y, theta, 0.01, integrates, volts)
    for j, step in enumerate(1e-6 * np.eye(len(theta))):
        above = predictions(x, y, theta + step, 0.01, integrates, volts)[0]
        below = predictions(x, y, theta - step, 0.01, integrates, volts)[0]
        np.testing.assert_allclose(slopes[:, j], (above - below) / 2e-6, rtol=1e-5, atol=1e-6)


def sagging(volts: float = 12.0) -> tuple[Dataset, Signal]:
    """A vertical axis whose motors turn with a share of a voltage that falls by a fifth."""
    rng = np.random.default_rng(4)
    x = np.repeat(rng.uniform(0.4, 1.0, (300, 1)), 10, axis=0)
    battery = np.linspace(1.1, 0.9, len(x)) * volts
    theta = np.zeros(len(NAMES) + 2)
    theta[:3] = 0.04, 0.01, 1.0
    theta[-2:] = -15.0, 1.0
    y = free_run(x, 0.0, theta, 0.01, False, False, np.log(battery / battery.mean()))
    y = y + 0.1 * rng.standard_normal(len(x))
    given = [Signal("throttle", ""), Signal("battery", "V")]
    output = Signal("az", "m/s/s")
    return Dataset.from_arrays(np.column_stack([x, battery]), y, 0.01, inputs=given, outputs=[output]), output


def test_what_the_battery_does_to_the_thrust_is_found() -> None:
    """Thrust is the square of a share of the voltage: a tenth less of it needs a ninth more of command."""
    data, _ = sagging()
    model = Multirotor().fit(data)
    power = {f.name: f for f in model.figures()}["power of the battery's voltage"]
    assert abs(power.value - 1.0) < 2 * power.half_width < 0.2
    ratio, half_width = model.hover_command(0.9 * 12.0)
    assert abs(ratio - 1.0 / 0.9) < 2 * half_width < 0.05
    same_thrust = "commands for the same thrust at 10.8 V, over those at 12 V"
    assert f"{same_thrust} {ratio:.4g} +- {half_width:.2g}" in str(model)
    assert same_thrust in [c.regressor for c in model.coefficients()]
    segment = data.segments[0]
    left = model.simulate(segment.u, segment.y[:1]) - segment.y
    assert left.std() < 0.12
    again = from_dict(json.loads(json.dumps(model.to_dict())))
    np.testing.assert_allclose(again.simulate(segment.u), model.simulate(segment.u))
    np.testing.assert_allclose(again.predict(segment.u, segment.y, 3), model.predict(segment.u, segment.y, 3))


def test_noise_of_the_voltage_is_taken_off_and_a_load_is_not() -> None:
    """A battery that sags by its load is quicker than any noise filter may be."""
    rng = np.random.default_rng(0)
    falling = np.linspace(0.05, -0.05, 4000)
    noise = 0.002 * rng.standard_normal(4000)
    found = quieten(falling + noise)
    assert found is not None
    assert (found - falling).std() < 0.2 * noise.std()
    loaded = falling - 0.03 * np.repeat(rng.integers(0, 2, 160), 25)
    found = quieten(loaded + noise)
    assert found is not None
    assert (found - loaded).std() < 1.01 * noise.std()


def test_a_voltage_without_sense_is_refused(fitted: FittedMultirotor) -> None:
    data, output = sagging()
    twice = [Signal("cell", "V"), Signal("battery", "V")]
    s = data.segments[0]
    with pytest.raises(UsageError, match="one voltage of the battery at most"):
        Multirotor().fit(Dataset.from_arrays(s.u, s.y, 0.01, inputs=twice, outputs=[output]))
    with pytest.raises(DataError, match="battery is not above 0 V"):
        Multirotor().fit(sagging(-12.0)[0])
    with pytest.raises(UsageError, match="no input is in volts"):
        fitted.hover_command(11.0)
    with pytest.raises(UsageError, match="cannot be exported"):
        program_of(Multirotor().fit(data))


def test_the_gain_of_its_rule_is_what_a_small_step_of_a_command_leads_to() -> None:
    """About the mean command, where the curve of the thrust bends the response."""
    rng = np.random.default_rng(6)
    x = np.repeat(rng.uniform(0.2, 1.0, (200, 2)), 10, axis=0)
    theta = np.zeros(len(NAMES) + 2)
    theta[:3] = 0.04, 0.01, 0.8
    theta[-2:] = -15.0, 9.0
    y = free_run(x, 0.0, theta, 0.01, False, False) + 0.01 * rng.standard_normal(len(x))
    commands = [Signal("front", ""), Signal("back", "")]
    data = Dataset.from_arrays(x, y, 0.01, inputs=commands, outputs=[Signal("az", "m/s/s")])
    model = Multirotor().fit(data)
    (rule,) = model.rules()
    step = 0.01
    for j, direction in enumerate(step * np.eye(2)):
        above, below = (
            model.simulate(np.tile(x.mean(axis=0) + d, (200, 1)))[-1] for d in (direction, -direction)
        )
        assert rule.dc_gain[0, j] == pytest.approx((above - below).item() / (2.0 * step), rel=1e-3)
    assert rule.time_constant_s == pytest.approx(0.04, rel=0.05)  # the lag of the motors
    assert rule.pole_radius == pytest.approx(np.exp(-0.01 / rule.time_constant_s))


def test_a_row_rate_does_not_change_the_motors() -> None:
    """Motors and torques are exact: held commands at twice the rows give the same rates."""
    rng = np.random.default_rng(1)
    slow = rng.uniform(0.2, 1.0, (200, 2))
    theta = np.zeros(len(NAMES) + 2)
    theta[:5] = 0.03, 0.013, 0.8, 0.0, 0.2
    theta[-2:] = 40.0, -35.0
    at_slow = free_run(slow, 0.0, theta, 0.01, True, False)
    at_fast = free_run(np.repeat(slow, 2, axis=0), 0.0, theta, 0.005, True, False)
    np.testing.assert_allclose(at_fast[::2], at_slow, atol=1e-9)


def test_known_numbers_are_found_again() -> None:
    rows = errors(1)
    assert {name for _, name, *_ in rows} >= {"motor lag", "dead time", "effect of motor 1"}
    for rate, name, value, true, _ in rows:
        assert abs(value / true - 1.0) < 0.05, (rate, name, value, true)
        if name == "motor lag":
            assert abs(value - true) < 0.005
    assert np.mean([held for *_, held in rows]) > 0.8


def test_what_flights_do_not_determine_is_named_and_not_printed(fitted: FittedMultirotor) -> None:
    figures = {f.name: f for f in fitted.figures(0)}
    idle = figures["effect of motor 1"]  # the front motor does not roll the vehicle
    assert not idle.is_determined
    assert str(idle) == "effect of motor 1: not determined by these flights"
    assert any(note.startswith("p: these flights do not determine") for note in fitted.notes)
    assert all(c.regressor != idle.name for c in fitted.coefficients() if c.output == "p")


def test_an_acceleration_is_told_by_its_unit() -> None:
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(0.3, 0.9, (150, 1)), 10, axis=0)
    theta = np.zeros(len(NAMES) + 1)
    theta[:5] = 0.04, 0.01, 1.0, 0.0, 0.5
    theta[-1] = -15.0
    y = free_run(u / u.max(), 0.0, theta, 0.01, False, False) + 0.1 * rng.standard_normal(len(u))
    data = Dataset.from_arrays(u, y, 0.01, outputs=[Signal("az", "m/s/s")])
    figures = {f.name: f for f in Multirotor().fit(data).figures()}
    assert "drag of the rotors" not in figures
    assert abs(figures["motor lag"].value - 0.04) < 2 * figures["motor lag"].half_width
    assert figures["motor lag"].value == pytest.approx(0.04, rel=0.05)


def test_signed_commands_have_no_thrust_curve() -> None:
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1.0, 1.0, (100, 1)), 10, axis=0)
    theta = np.zeros(len(NAMES) + 1)
    theta[:2] = 0.03, 0.01
    theta[-1] = 10.0
    y = free_run(u, 0.0, theta, 0.01, True, False) + 0.02 * rng.standard_normal(len(u))
    names = [f.name for f in Multirotor().fit(Dataset.from_arrays(u, y, 0.01)).figures()]
    assert not any(name.startswith("thrust curve") for name in names)


def test_what_cannot_be_fitted_is_refused() -> None:
    with pytest.raises(UsageError, match=r"kind is .*, not 'torque'"):
        Multirotor(kind="torque").fit(flown(1, seconds=2.0)[0])  # type: ignore[arg-type]
    with pytest.raises(DataError, match="too few for a physical model"):
        Multirotor().fit(Dataset.from_arrays(np.arange(30.0), np.arange(30.0) ** 2, 0.01))


@pytest.mark.parametrize(
    ("key", "value"), [("theta", -1.0), ("u_scale", 0.0), ("y_scale", -1.0), ("covariance", 1.0)]
)
def test_a_forged_file_is_refused(fitted: FittedMultirotor, key: str, value: float) -> None:
    document = json.loads(json.dumps(fitted.to_dict()))
    document[key] = [[value] * 11] * 3 if key == "theta" else [value] * 3
    with pytest.raises((ValueError, TypeError)):
        from_dict(document)


def test_the_recipe_names_four_motors() -> None:
    recipe = load_recipe("rotorcraft-motors")
    assert {c.inputs for c in recipe.channels.values()} == {("motor1", "motor2", "motor3", "motor4")}
    assert "m/s/s" in recipe.signals["z_acceleration"].unit


def test_the_trim_is_not_what_wind_did_at_the_first_row() -> None:
    """Gusts of 50 deg/s/s that begin at 100: the trim of two opposed motors read what it began with."""
    held = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        u = 0.5 + 0.1 * np.repeat(rng.normal(size=(200, 2)), 20, axis=0)
        keep = np.exp(-0.01)
        kicks = np.append(100.0, 50.0 * np.sqrt(1.0 - keep**2) * rng.normal(size=len(u) - 1))
        fade = np.exp(-0.01 / 0.05)
        speed = lfilter([0.0, 1.0 - fade], [1.0, -fade], u - u[0], axis=0) + u[0]
        torque = 1000.0 * (speed[:, 0] - speed[:, 1]) + lfilter([1.0], [1.0, -keep], kicks)
        y = 0.01 * np.cumsum(torque) + 0.05 * rng.normal(size=len(u))
        motors = (Signal("m1", ""), Signal("m2", ""))
        data = Dataset(0.01, motors, (Signal("p", "deg/s"),), (Segment(u, y[:, None]),))
        trim = Multirotor().fit(data).figures()[-1]
        held += abs(trim.value) < trim.half_width < 200.0
    assert held >= 5
