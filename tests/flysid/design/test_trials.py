"""Trial flights: what is drawn, what the true plant answers, and the results beside each other."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli.fly import command
from flysid.design.campaign import fly_design
from flysid.design.designed import Axis, Design, DesignMeaning
from flysid.design.drawn_plants import PlantSet, grid
from flysid.design.gain_search import Bounds
from flysid.design.law import Gains
from flysid.design.trialflight import (
    PERIOD_S,
    Doubtful,
    Trial,
    course,
    fly_trial,
    held_wind_m_s,
    true_plants,
)
from flysid.errors import UsageError
from flysid.ingest.synth.dryden import Wind
from flysid.ingest.synth.rigid_body import SimulatedVehicle, fly_vehicle

STILL = Doubtful(position_noise_m=0.0, velocity_noise_m_s=0.0)
CALM = Wind(0.0, turbulent=False)


def axis_of(plants: PlantSet, input_: str = "theta_in", sign: float = 1.0) -> Axis:
    laws = {
        "present": Gains(1.43, 4.2),
        "present_x2": Gains(1.43, 8.4),
        "goal": Gains(1.8, 12.8, 0.1, 1.5, 1.6),
    }
    meanings = {name: DesignMeaning.of(law, plants) for name, law in laws.items()}
    units = ("deg", "m/s")
    band = (0.05, 1.5)
    return Axis(
        "longitudinal", input_, "v_x", units, sign, PERIOD_S, laws, meanings, Bounds(), ("truth",), band
    )


def nominal_plants() -> PlantSet:
    omega = grid(PERIOD_S)
    return PlantSet(PERIOD_S, omega, ("truth",), true_plants(SimulatedVehicle(), omega)["x"][None])


def test_the_true_plant_is_what_a_small_sine_finds() -> None:
    load = 1.2
    nominal = SimulatedVehicle()
    vehicle = replace(nominal, airframe=replace(nominal.airframe, load=load), delay_s=0.04)
    omega = 2.0
    time = np.arange(2000) * PERIOD_S
    tilt = 0.2 * np.sin(omega * time)
    for axis, signal in (("x", "vx"), ("y", "vy")):
        column = 0 if axis == "x" else 1
        commands = np.zeros((len(time), 3))
        commands[:, column] = tilt
        seen = fly_vehicle(vehicle, commands).series()[signal]
        last = time >= time[-1] - 4.0 * 2.0 * np.pi / omega
        basis = np.column_stack([np.exp(1j * omega * time[last]), np.exp(-1j * omega * time[last])])
        amplitude = np.linalg.lstsq(basis, seen[last].astype(complex), rcond=None)[0][0] / (-0.5j * 0.2)
        told = true_plants(vehicle, np.array([omega]))[axis][0]
        assert abs(amplitude / told - 1.0) < 0.03


def test_a_heavier_vehicle_is_another_plant_and_flies_without_retuning() -> None:
    nominal = SimulatedVehicle()
    heavy = replace(nominal, airframe=replace(nominal.airframe, load=1.3))
    assert heavy.physics().m == nominal.physics().m
    laws = (Gains(1.43, 8.4), Gains(1.43, 8.4))
    light = fly_trial(Trial(nominal, CALM, 1), laws, STILL)
    loaded = fly_trial(Trial(heavy, CALM, 1), laws, STILL)
    assert not loaded["x"].lost
    assert loaded["x"].ise != light["x"].ise


def test_drawn_vehicles_differ_and_are_the_same_again() -> None:
    doubtful = Doubtful()
    first, again, other = (Trial.drawn(doubtful, 3, n) for n in (5, 5, 6))
    assert first == again
    assert first.vehicle != other.vehicle
    assert all(0.8 <= Trial.drawn(doubtful, 3, n).vehicle.airframe.load <= 1.2 for n in range(50))
    with pytest.raises(UsageError, match="mass"):
        Doubtful(mass=(1.2, 0.8))


def test_a_trial_is_repeatable_and_wind_costs() -> None:
    doubtful = Doubtful()
    laws = (Gains(1.43, 8.4), Gains(1.43, 8.4))
    calm = fly_trial(Trial(SimulatedVehicle(), CALM, 4), laws, doubtful)
    assert calm == fly_trial(Trial(SimulatedVehicle(), CALM, 4), laws, doubtful)
    windy = fly_trial(Trial(SimulatedVehicle(), Wind(2.0, 180.0), 4), laws, doubtful)
    assert windy["x"].ise > calm["x"].ise
    beyond = fly_trial(Trial(SimulatedVehicle(), Wind(6.0, 90.0, turbulent=False), 4), laws, doubtful)
    assert beyond["y"].saturated > 0.5
    assert beyond["y"].blown


def test_full_tilt_holds_the_stated_wind() -> None:
    held = held_wind_m_s(SimulatedVehicle())
    for axis, column, towards in (("x", 0, 180.0), ("y", 1, 90.0)):
        drift = []
        for factor in (0.9, 1.1):
            wind = np.zeros((1000, 3))
            angle = math.radians(towards)
            wind[:, :2] = factor * held[axis] * np.array([math.cos(angle), math.sin(angle)])
            commands = np.zeros((1000, 3))
            commands[:, column] = 12.0
            flown = fly_vehicle(SimulatedVehicle(), commands, wind_m_s=wind).series()
            drift.append(float(flown[f"v{axis}"][-1]))
        assert drift[0] > 0.0 > drift[1]


def test_the_course_begins_at_rest_and_its_speed_is_its_slope() -> None:
    place, speed = course()
    assert not place[:50].any()
    sine = slice(round(25.0 / PERIOD_S), None)
    slope = np.gradient(place[sine, 0], PERIOD_S)
    assert np.abs(slope - speed[sine, 0])[1:-1].max() < 1e-3


def test_a_better_law_is_seen_to_be_better_beside_the_present_one() -> None:
    campaign = fly_design([axis_of(nominal_plants())], 6, 11, Doubtful(wind_m_s=(0.0, 1.0)))
    present, twice, goal = campaign.rows["x"]
    assert (present.law, twice.law, goal.law) == ("present", "present_x2", "goal")
    assert (present.better, present.worse) == (0.0, 0.0)
    assert goal.better > 0.8
    assert goal.lost == 0
    assert goal.stable
    assert present.ms[1] < goal.ms[1] < 2.0
    assert "not designed" in " ".join(campaign.notes)
    assert campaign.rows["y"][2].ise[0] == pytest.approx(campaign.rows["y"][0].ise[0], rel=0.1)


def test_designs_that_the_simulated_vehicle_cannot_fly_are_refused() -> None:
    plants = nominal_plants()
    with pytest.raises(UsageError, match="driven by"):
        fly_design([axis_of(plants, "roll")], 1, 1, Doubtful())
    with pytest.raises(UsageError, match="falls as"):
        fly_design([axis_of(plants, sign=-1.0)], 1, 1, Doubtful())
    with pytest.raises(UsageError, match="50 Hz"):
        fly_design([replace(axis_of(plants), dt_s=0.1)], 1, 1, Doubtful())
    with pytest.raises(UsageError, match="vehicles"):
        fly_design([axis_of(plants)], 0, 1, Doubtful())


def test_fly_writes_one_page_and_says_the_same_in_json(tmp_path: Path) -> None:
    design = Design("run <b>", ("pid", "words"), (axis_of(nominal_plants()),))
    (tmp_path / "design.json").write_text(design.files()["design.json"], "utf-8")
    page = tmp_path / "trials.html"
    told = ["--vehicles", "3", "--wind", "1", "-q", "-o", str(page)]
    done = CliRunner().invoke(
        command, [str(tmp_path / "design.json"), *told, "--json"], standalone_mode=False
    )
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)["axes"]["x"]
    text = page.read_text("utf-8")
    assert f"{rows[2]['ise'][0]:.1f}," in text
    assert text.count("<svg") == 2
    assert "not tested on your vehicle" in text
    assert "http" not in text.split("</head>")[1]
