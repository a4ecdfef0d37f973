"""Commands logged only where they change, and merged tables: held, not cut, and not late."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

from flysid.cli import root
from flysid.dataset import FloatArray
from flysid.ingest.align.on_change import is_logged_on_change
from flysid.ingest.align.quick import dataset_from
from flysid.ingest.align.resample import RecordedSignal, hold, hold_mean, jitter_ns

LAG_S = 0.3
GAIN = 2.0
STEP_S = 0.001
OUTPUT_S = 1.0 / 30.0
MS = 1_000_000


def logged(at_ms: npt.ArrayLike, values: npt.ArrayLike) -> RecordedSignal:
    at_ns = np.round(np.asarray(at_ms, dtype=np.float64) * MS)
    return RecordedSignal(at_ns.astype(np.int64), np.asarray(values, dtype=np.float64))


def changes(kind: str, rng: np.random.Generator, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Times and values of a command: a row where it changes, or rows of its own rate."""
    if kind == "on change":
        times = np.append(0.0, np.cumsum(rng.uniform(0.1, 1.5, round(2.0 * seconds))))
        times = np.append(times[times < 0.5 * seconds], times[times > 0.5 * seconds] + 4.0)  # a long pause
        return times, rng.normal(size=len(times))
    times = np.arange(0.0, seconds, 0.02)
    return times, np.repeat(rng.normal(size=len(times) // 17 + 1), 17)[: len(times)]


def merged_table(path: Path, kind: str, seed: int, seconds: float = 60.0) -> Path:
    """A first-order lag; every row has the one value that was logged then, as merged exports do."""
    rng = np.random.default_rng(seed)
    times, values = changes(kind, rng, seconds)
    fine = STEP_S * np.arange(round(seconds / STEP_S))
    u = values[np.searchsorted(times, fine + 1e-9, side="right") - 1]
    pole = np.exp(-STEP_S / LAG_S)
    y = lfilter([0.0, GAIN * (1.0 - pole)], [1.0, -pole], u)
    at = np.arange(0.0, seconds - STEP_S, OUTPUT_S)
    seen = np.interp(at, fine, y) + 0.05 * rng.normal(size=len(at))
    rows = sorted(
        [(t, f"{v:.9g},") for t, v in zip(times, values, strict=True)]
        + [(t, f",{v:.9g}") for t, v in zip(at, seen, strict=True)]
    )
    path.write_text("\n".join(["time_s,u,y", *(f"{t:.6f},{cells}" for t, cells in rows), ""]), "utf-8")
    return path


@pytest.mark.parametrize("kind", ["on change", "merged"])
def test_tf_finds_the_lag_and_the_gain_of_a_merged_table(kind: str, tmp_path: Path) -> None:
    """It read .281 +- .0041 s and 1.976 +- .011, and saw a loop."""
    table = merged_table(tmp_path / "merged.csv", kind, 11)
    asked = ["tf", str(table), "--from", "u", "--to", "y", "--poles", "1", "--zeros", "0", "--json", "-q"]
    done = CliRunner().invoke(root, asked, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    (channel,) = json.loads(done.stdout)["channels"]
    (transfer,) = channel["transfers"]
    for found, true in ((transfer["gain"], GAIN), (transfer["modes"][0]["time_constant_s"], LAG_S)):
        assert abs(found["value"] - true) < found["high"] - found["low"], found
    assert not channel["feedback"][0]["closed"]


def test_step_reads_the_same_lag(tmp_path: Path) -> None:
    """From 10 to 90 % a lag takes 2.2 time constants; it was refused as a loop."""
    table = merged_table(tmp_path / "merged.csv", "merged", 12)
    asked = ["step", str(table), "--from", "u", "--to", "y", "--json", "-q"]
    done = CliRunner().invoke(root, asked, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert "rise" in done.stdout


@pytest.mark.parametrize("kind", ["on change", "merged"])
def test_a_merged_table_is_one_segment_at_the_rate_of_its_output(kind: str, tmp_path: Path) -> None:
    data = dataset_from(merged_table(tmp_path / "merged.csv", kind, 3), "u", "y")
    assert len(data.segments) == 1
    assert data.dt_s == pytest.approx(OUTPUT_S, rel=1e-3)


def test_a_command_counts_from_where_it_changes() -> None:
    """By hand: 0, then 1 from 13 ms, then 3 from 16 ms, of steps of 10 ms."""
    series = logged(np.array([0.0, 13.0, 16.0]), np.array([0.0, 1.0, 3.0]))
    grid = np.array([0, 10, 20]) * MS
    assert hold_mean(series, grid, 10.0 * MS) == pytest.approx([0.0, 0.3 * 1.0 + 0.4 * 3.0, 3.0])
    early = hold_mean(logged(np.array([5.0]), np.array([2.0])), grid, 10.0 * MS)
    assert np.isnan(early[0])
    assert list(early[1:]) == [2.0, 2.0]


def test_the_mean_is_that_of_a_fine_grid(fresh_seed: int) -> None:
    rng = np.random.default_rng(fresh_seed)
    series = logged(np.cumsum(rng.integers(1, 30, 200)).astype(float), rng.normal(size=200))
    grid = np.arange(40 * MS, int(series.t_ns[-1]), 20 * MS)
    fine = np.array([hold(series, g + MS * np.arange(20)).mean() for g in grid])
    np.testing.assert_allclose(hold_mean(series, grid, 20.0 * MS), fine, atol=1e-12)


def test_stamps_on_the_grid_come_through_bit_for_bit() -> None:
    values = np.random.default_rng(1).normal(size=50)
    series = logged(np.arange(0.0, 1000.0, 20.0), values)
    np.testing.assert_array_equal(hold_mean(series, series.t_ns, 20.0 * MS), values)


def test_what_is_logged_on_change_is_told_from_rates_bursts_and_jitter() -> None:
    rng = np.random.default_rng(2)
    new = rng.normal(size=300)
    uneven = np.cumsum(rng.uniform(100.0, 1500.0, 300))
    assert is_logged_on_change(logged(uneven, new))
    assert not is_logged_on_change(logged(uneven, np.repeat(new[:100], 3)))
    assert not is_logged_on_change(logged(20.0 * np.arange(300) + rng.uniform(-5.0, 5.0, 300), new))
    bursts = np.sort(np.repeat(200.0 * np.arange(75), 4) + np.tile([0.0, 1.0, 2.0, 3.0], 75))
    assert not is_logged_on_change(logged(bursts, new))
    assert not is_logged_on_change(logged(uneven[:5], new[:5]))


def stamped_table(path: Path, jitter_s: float, seed: int, lag_s: float = 0.03) -> Path:
    """A lag of 30 ms whose output is logged at 100 Hz; commands at 50 Hz are stamped late by chance."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, 60.0, 0.02)
    values = np.repeat(rng.normal(size=len(times) // 15 + 1), 15)[: len(times)]
    stamps = np.sort(times + rng.uniform(0.0, jitter_s, len(times)))
    fine = STEP_S * np.arange(60_000)
    pole = np.exp(-STEP_S / lag_s)
    u = values[np.searchsorted(times, fine + 1e-9, side="right") - 1]
    y = lfilter([0.0, 1.0 - pole], [1.0, -pole], u)[::10]
    y = y + 0.01 * rng.normal(size=len(y))
    rows = sorted(
        [(t, f"{v:.9g},") for t, v in zip(stamps, values, strict=True)]
        + [(t, f",{v:.9g}") for t, v in zip(fine[::10], y, strict=True)]
    )
    path.write_text("\n".join(["time_s,u,y", *(f"{t:.6f},{cells}" for t, cells in rows), ""]), "utf-8")
    return path


def test_a_lag_behind_a_low_pass_is_not_shortened_by_half_a_step(tmp_path: Path) -> None:
    """It read 24.3 ms, and a reaction of 12 to 16 %: what passes the low-pass was taken for a stair."""
    table = stamped_table(tmp_path / "fast.csv", 0.0, 13)
    asked = ["tf", str(table), "--from", "u", "--to", "y", "--poles", "1", "--zeros", "0", "--json", "-q"]
    (channel,) = json.loads(CliRunner().invoke(root, asked, catch_exceptions=False).stdout)["channels"]
    lag = channel["transfers"][0]["modes"][0]["time_constant_s"]["value"]
    assert lag == pytest.approx(0.03, abs=0.0015)
    assert channel["feedback"][0]["share"] < 0.012


def test_the_scatter_of_stamps_is_said_with_its_size(tmp_path: Path) -> None:
    table = stamped_table(tmp_path / "late.csv", 0.005, 14)
    asked = ["tf", str(table), "--from", "u", "--to", "y", "--poles", "1", "--zeros", "0", "-q"]
    said = " ".join(CliRunner().invoke(root, asked, catch_exceptions=False).stdout.split())
    found = re.search(r"stamps of the inputs scatter by \+-([\d.]+) ms \(95 %\)", said)
    assert found, said
    assert float(found[1]) == pytest.approx(1.96 * 5.0 / np.sqrt(12.0), rel=0.2)


def test_jitter_is_that_of_single_stamps() -> None:
    rng = np.random.default_rng(7)
    at = 20.0 * np.arange(4000) + 1.5 * rng.normal(size=4000)
    assert jitter_ns(logged(at, at).t_ns) == pytest.approx(1.5 * MS, rel=0.1)
    lossy = at[rng.random(4000) > 0.2]
    assert jitter_ns(logged(lossy, lossy).t_ns) == pytest.approx(1.5 * MS, rel=0.2)
    assert jitter_ns(logged(np.arange(0.0, 180.0, 20.0), at[:9]).t_ns) == 0.0
    assert jitter_ns(logged(at[:1], at[:1]).t_ns) == 0.0
