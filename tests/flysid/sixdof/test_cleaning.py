"""Damage of telemetry is found, counted and left out: lines over link losses, impossible commands, clocks."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import butter, sosfilt

import flysid
from flysid.cli import root
from flysid.dataset import Dataset
from flysid.ingest.align.resample import lowpass
from flysid.sixdof import layout
from flysid.sixdof.cleaning import SampleFaults, clock_offsets, straight_lines
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.records import Scale, find_scale, flights_of
from tests.flysid.sixdof.hidden_quad import write_table


def damaged(data: Dataset, first: int, length: int, times: float) -> Dataset:
    """The first flight with a link loss: all signals run straight, motors to `times` full scale."""
    segment = data.segments[0]
    u, y = segment.u.copy(), segment.y.copy()
    rows = slice(first, first + length)
    way = np.linspace(0.0, 1.0, length)[:, None]
    u[rows] = u[first] + way * (times - u[first])
    y[rows] = y[first] + way * (30.0 - y[first])
    return data.with_segments([replace(segment, u=u, y=y), *data.segments[1:]])


def test_a_link_loss_is_counted_and_left_out(still: Dataset) -> None:
    found = flights_of(damaged(still, 500, 200, 73.0), Scale(0.0, 1.0))
    (damage,) = found.damage
    assert damage.straight_runs == 1
    assert damage.straight == pytest.approx(200, abs=4)
    assert damage.beyond == pytest.approx(198, abs=4)
    assert damage.most == pytest.approx(73.0)
    assert not found.records[0].flying[505:695].any()
    assert "200" in damage.lines[0] or "19" in damage.lines[0] or "20" in damage.lines[0]


def test_a_link_loss_changes_no_number(still: Dataset, regressed: FittedVehicle) -> None:
    with_loss = flysid.Vehicle(free_runs=False).fit(damaged(still, 500, 300, 20.0))
    np.testing.assert_allclose(
        with_loss["roll of motor 1"].value, regressed["roll of motor 1"].value, rtol=0.1
    )
    assert any("straight" in line for line in with_loss.lines())


def test_motors_follow_no_command_that_a_loss_invents(still: Dataset, regressed: FittedVehicle) -> None:
    """Ten losses of half a second, behind each of which motors would come down from full scale."""
    data = still
    for first in range(200, 2300, 210):
        data = damaged(data, first, 50, 70.0)
    record = flights_of(data, Scale(0.0, 1.0)).records[0]
    assert np.abs(np.diff(record.commands[200:252], axis=0)).max() < 0.2
    found = layout.effects(flysid.Vehicle(free_runs=False).fit(data).theta)
    wanted = layout.effects(regressed.theta)
    assert np.linalg.norm(found - wanted) < 0.2 * np.linalg.norm(wanted)


def test_a_whole_flight_has_no_damage(still: Dataset) -> None:
    (damage,) = flights_of(still).damage
    assert damage.lines == []
    assert not damage.wanders


@pytest.mark.parametrize("full", [0.65, 1.0])
def test_a_motor_at_its_stop_is_no_damage(still: Dataset, full: float) -> None:
    """As PX4 logs it: commands stand at zero before take-off, and the low-pass of the grid rings there."""
    segment = still.segments[0]
    u = segment.u * full / segment.u.max()
    first, last = 300, 600
    u[first:last] = 0.0
    u[:] = np.apply_along_axis(np.convolve, 0, u, lowpass(4), mode="same")
    u[last - 60 : last - 40] -= 2e-5  # as filtered: not exactly still
    at_rest = replace(segment, u=u)
    (damage,) = flights_of(still.with_segments([at_rest]), Scale(0.0, 1.0)).damage
    assert damage.straight == 0
    assert damage.beyond == 0


def test_one_clock_on_a_slow_grid_does_not_wander() -> None:
    at_10_hz = SampleFaults("f", 0.1, 900, 0, 0, 0, 0.0, 1.0, 0.019, 0.038)
    assert not at_10_hz.wanders
    assert replace(at_10_hz, dt_s=0.01).wanders


@pytest.mark.parametrize("standing", [True, False])
def test_what_stands_still_is_a_line_of_an_instrument_only(standing: bool) -> None:
    x = np.random.default_rng(0).standard_normal((200, 2))
    x[50:80] = x[50]
    assert straight_lines(x, 0.01, standing=standing)[50:80].all() == standing


def test_a_slow_coarse_gyro_shows_no_line_by_chance_and_still_a_loss() -> None:
    sos = butter(2, 0.02, output="sos")
    for seed in range(40):
        gyro = sosfilt(sos, np.random.default_rng(seed).standard_normal((3000, 3)), axis=0)
        coarse = np.round(0.25 * gyro / gyro.std() / 0.05) * 0.05
        assert not straight_lines(coarse, 0.02, standing=True).any()
        coarse[1000:1060] = coarse[1000] + np.linspace(0.0, 1.0, 60)[:, None] * (
            coarse[1059] + 0.37 - coarse[1000]
        )
        assert straight_lines(coarse, 0.02, standing=True)[1003:1057].mean() > 0.9


def test_a_wandering_clock_is_measured() -> None:
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 60.0, 0.01)
    late = 0.03 * np.sin(2.0 * np.pi * t / 30.0)
    parts = [(rng.uniform(0.3, 3.0), rng.uniform(0.0, 6.0)) for _ in range(24)]
    gyro = np.stack([sum(np.sin(2 * np.pi * f * t + p + k) for f, p in parts) for k in range(3)], axis=1)
    other = np.stack([np.interp(t - late, t, gyro[:, k]) for k in range(3)], axis=1)
    _, found = clock_offsets(gyro, other, np.ones(len(t), dtype=bool), 0.01)
    clock = float(found.std(ddof=1)), float(np.ptp(found))
    damage = SampleFaults("f", 0.01, len(t), 0, 0, 0, 0.0, 1.0, *clock)
    assert damage.clock_sd_s == pytest.approx(late.std(), rel=0.25)
    assert "wanders" in " ".join(damage.lines)


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ([0.0, 0.4, 0.9], Scale(0.0, 1.0)),
        ([0.0, 40.0, 95.0], Scale(0.0, 100.0)),
        ([0.0, 120.0, 240.0], Scale(0.0, 255.0)),
        ([0.0, 240.0, 480.0], Scale(0.0, 1000.0)),
        ([0.0, 1500.0, 3900.0], Scale(0.0, 4095.0)),
        ([250.0, 1100.0, 1900.0], Scale(48.0, 1999.0)),
        ([*[500.0] * 18, 2047.0], Scale(48.0, 1999.0)),
        ([1100.0, 1500.0, 1900.0], Scale(1000.0, 1000.0)),
        ([0.0, 30000.0, 65000.0], Scale(0.0, 65535.0)),
    ],
)
def test_the_scale_of_commands_is_found(values: list[float], scale: Scale) -> None:
    assert find_scale(np.repeat(values, 10)) == scale


def test_doctor_tells_of_damage_as_vehicle_does(still: Dataset, tmp_path: Path) -> None:
    table = write_table(tmp_path / "flight.csv", damaged(still, 500, 200, 73.0))
    done = CliRunner().invoke(root, ["doctor", str(table), "-q"])
    told = " ".join(done.stdout.split())
    assert "as a link loss leaves them: " in told
    assert "to 73 times full scale" in told
    done = CliRunner().invoke(root, ["doctor", str(table), "--json"])
    assert len(json.loads(done.stdout)["logs"][0]["telemetry"]) == 2
    done = CliRunner().invoke(root, ["doctor", str(write_table(tmp_path / "whole.csv", still)), "-q"])
    assert "link loss" not in done.stdout
