"""Clocks that run apart, from a table to what `flysid tf` prints of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

from flysid.cli import root
from flysid.dataset import Dataset
from flysid.model.frequency.response import measure_response
from flysid.validate.transfers.agreement import misfit

STEP_S = 0.02
LAG_S = 0.2


def table(path: Path, grows_s: float, *, bent: float = 0.0) -> Path:
    """A lag of 0.2 s for 80 s, its output later at the end by `grows_s` than at the beginning."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.normal(size=401), 10)[:4000]
    fine = STEP_S / 20.0
    pole = np.exp(-fine / LAG_S)
    force = np.repeat(u + bent * u**3, 20)
    y = lfilter([0.0, 1.0 - pole], [1.0, -pole], force)
    at = STEP_S * np.arange(4000) * (1.0 - grows_s / 80.0)
    seen = np.interp(at, fine * np.arange(len(y)), y) + 0.02 * rng.normal(size=4000)
    rows = (f"{STEP_S * k:.6f},{u[k]:.9g},{seen[k]:.9g}" for k in range(4000))
    path.write_text("\n".join(["time_s,u,y", *rows, ""]), "utf-8")
    return path


def tf(path: Path, *more: str) -> Any:
    asked = ["tf", str(path), "--from", "u", "--to", "y", "--poles", "1", "--zeros", "0", *more, "-q"]
    return CliRunner().invoke(root, asked, catch_exceptions=False).stdout


def phase(channel: Any) -> tuple[float, float]:
    """(error, half width) in degrees at the frequency near 5 rad/s, of the plant without its clock."""
    (measured,) = channel["measured"]
    k = int(np.argmin(np.abs(np.array(measured["omega_rad_s"]) - 5.0)))
    omega = measured["omega_rad_s"][k]
    z = np.exp(-1j * omega * STEP_S)
    pole = np.exp(-STEP_S / LAG_S)
    true = np.degrees(np.angle((1.0 - pole) * z / (1.0 - pole * z)))
    return abs(measured["phase_deg"][k] - true), measured["phase_deg_half_width"][k]


def test_two_clocks_that_run_apart_are_seen_and_enter_the_phase(tmp_path: Path) -> None:
    """No sentence named the clocks, and the interval of the phase missed the truth."""
    path = table(tmp_path / "apart.csv", 0.01)
    (channel,) = json.loads(tf(path, "--json"))["channels"]
    (caution,) = channel["cautions"]
    assert "Two clocks that run apart" in caution
    grown, error = (float(word) for word in caution.split("comes ")[1].split(" ms")[0].split(" +- "))
    assert abs(grown - 10.0) < 2.0 * error
    off, half = phase(channel)
    assert off < half


def test_one_clock_costs_nothing(tmp_path: Path) -> None:
    (channel,) = json.loads(tf(table(tmp_path / "one.csv", 0.0), "--json"))["channels"]
    assert channel["cautions"] == []
    off, half = phase(channel)
    assert off < half < 1.0


def test_a_dead_time_that_was_not_estimated_has_no_interval(tmp_path: Path) -> None:
    """It read [0, 0]: known without error, where the text says nothing of it."""
    (channel,) = json.loads(tf(table(tmp_path / "one.csv", 0.0), "--json", "--dead-time", "0"))["channels"]
    (transfer,) = channel["transfers"]
    assert transfer["dead_time"] == {"value": 0.0, "low": None, "high": None}


@pytest.mark.parametrize("bent", [0.0, 0.15])
def test_a_model_is_known_no_better_than_it_follows(bent: float) -> None:
    """Beside a model of the right shape whose gain is off by a factor, which its parameters cannot know."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.normal(size=400), 10)
    pole = np.exp(-0.1)
    y = lfilter([0.0, 1.0 - pole], [1.0, -pole], u) + 0.01 * rng.normal(size=4000)
    measured = measure_response(Dataset.from_arrays(u, y, STEP_S, inputs=["u"], outputs=["y"]))
    z = np.exp(-1j * measured.omega * STEP_S)
    right = (1.0 - pole) * z / (1.0 - pole * z)
    off = misfit(measured, 0, right * np.exp(bent), np.ones(len(measured.omega), dtype=bool))
    seen = off[measured.trusted(0) > 0.0]
    # of a factor, half the square is in ln |G|: the phase has none
    assert np.median(seen) == pytest.approx(bent / np.sqrt(2.0), abs=0.01)
