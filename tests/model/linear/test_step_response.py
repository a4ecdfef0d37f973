"""Step responses from ordinary flying: the truth lies in the intervals, a loop is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from bench.closed_loop import Loop, direct
from bench.step_coverage import DT_S, flown, held, polynomials, true_step
from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.low_order_response import _realise
from flysid.model.shared import sharing
from flysid.model.step_figures import StepCurve
from flysid.model.step_response import step_response
from tests.command import call


def test_coloured_noise_and_the_truth_within_the_interval() -> None:
    found = [step_response(flown(seed)) for seed in range(4)]
    assert 0.85 < np.mean([held(f) for f in found]) <= 1.0
    for response in found:
        figures = {f.name: f for f in response.figures}
        assert figures["overshoot"].value == pytest.approx(100 * (true_step(200).max() - 1), abs=2.0)
        assert figures["final value"].value == pytest.approx(1.0, abs=0.06)
        assert figures["latency"].value == pytest.approx(42.0, abs=12.0)
        assert all(f.low is not None and f.value is not None and f.low < f.value for f in figures.values())


def test_a_record_that_two_verbs_ask_about_is_answered_once() -> None:
    one, same = (flown(0) for _ in range(2))
    with sharing():
        found = step_response(one, 0, 0, horizon_s=0.2)
        assert step_response(same, 0, 0, horizon_s=0.2) is found
        assert step_response(same, 0, 0, horizon_s=0.3) is not found


def test_a_response_that_no_low_order_has_is_held_as_well() -> None:
    """Two resonances, one of them fast, behind 30 ms of dead time."""
    b, a = np.ones(1), np.ones(1)
    for omega, damping in ((9.0, 0.5), (35.0, 0.15)):
        pole = omega * (-damping + 1j * np.sqrt(1.0 - damping**2))
        own = np.real(np.poly(np.exp(np.array([pole, np.conj(pole)]) * DT_S)))
        b, a = np.convolve(b, [own.sum()]), np.convolve(a, own)
    late = np.append(np.zeros(3), b)
    true = lfilter(late, a, np.ones(200))
    inside = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.standard_normal(121), 50)[:6000]
        y = lfilter(late, a, u)
        y = y + 0.1 * y.std() * lfilter([0.3], [1.0, -0.95], rng.standard_normal(len(u)))
        low, high = step_response(Dataset.from_arrays(u, y, DT_S)).interval
        inside.append(np.mean(((low <= true) & (true <= high))[1:]))
    assert np.mean(inside) > 0.85


def test_taps_of_a_low_order_give_its_coefficients_back() -> None:
    """With a part that passes at once, which is no part of the states."""
    b, a = np.array([2.0, 0.3, -0.1]), np.array([1.0, -1.5, 0.7])
    taps = lfilter(b, a, np.eye(1, 40)[0])
    np.testing.assert_allclose(_realise(taps, 2), [*b, *a[1:]], atol=1e-9)


def test_an_input_that_answers_the_output_is_refused() -> None:
    data = direct(Loop(0.2, rate_hz=100.0, seconds=30.0).flown(1))
    with pytest.raises(DataError, match="loop: not a step response") as refused:
        step_response(data, horizon_s=1.0)
    assert "--anyway" in refused.value.hint
    assert "a loop seems closed" in step_response(data, horizon_s=1.0, anyway=True).words


def test_a_fast_stick_and_a_slow_one() -> None:
    """The gain halves for large commands: the classes tell, each with what it rests on."""
    rng = np.random.default_rng(2)
    blocks = np.where(np.arange(60) < 30, 20.0, 200.0) * rng.uniform(-1.0, 1.0, 60)
    u = np.repeat(blocks, 200)
    y = np.asarray(lfilter(*polynomials(), np.where(np.arange(len(u)) < 6000, 1.0, 0.5) * u))
    data = Dataset.from_arrays(u, y + rng.standard_normal(len(u)), DT_S, inputs=["stick"])
    slow = step_response(data, below=20.0)
    fast = step_response(data, above=20.0)
    assert slow.step[-20:].mean() == pytest.approx(1.0, abs=0.15)
    assert fast.step[-20:].mean() == pytest.approx(0.5, abs=0.1)
    assert (slow.words, fast.words) == ("stick below 20", "stick above 20")
    with pytest.raises(DataError, match="never exceeds 1000: at most 198"):
        step_response(data, above=1000.0)


def test_what_cannot_be_is_said() -> None:
    data = flown(0)
    with pytest.raises(UsageError, match="horizon_s must be positive"):
        step_response(data, horizon_s=0.0)
    with pytest.raises(DataError, match="no segment is longer than the response of 100 s"):
        step_response(data, horizon_s=100.0)


def test_two_logs_over_each_other(tmp_path: Path) -> None:
    for seed in (1, 2):
        (segment,) = flown(seed).segments
        rows = np.column_stack([np.arange(len(segment)) * DT_S, segment.u, segment.y])
        name = tmp_path / f"log{seed}.csv"
        np.savetxt(name, rows, delimiter=",", header="time_s,stick,rate", comments="", fmt="%.9g")
    order = ["step", "log1.csv", "--from", "stick", "--to", "rate", "--against", "log2.csv", "--json", "-q"]
    done = call(*order, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    steps = json.loads(done.stdout)["steps"]
    assert [s["of"] for s in steps] == ["log1.csv", "log2.csv"]
    assert all(s["figures"]["rise"]["low"] < s["figures"]["rise"]["high"] for s in steps)


def test_a_response_longer_than_two_seconds_is_followed_to_its_end() -> None:
    """2 s of a slow plant looked settled: the taps fade by assumption. Settling was printed as 1.9 s."""
    rng = np.random.default_rng(7)
    for damping in (0.15, 0.3):
        pole = 1.3 * (-damping + 1j * np.sqrt(1.0 - damping**2))
        a = np.real(np.poly(np.exp(np.array([pole, np.conj(pole)]) * 0.05)))
        u = np.repeat(rng.standard_normal(400), 12)
        y = lfilter([0.0, a.sum() / 2, a.sum() / 2], a, u)
        data = Dataset.from_arrays(u, y + 0.05 * y.std() * rng.standard_normal(len(y)), 0.05)
        true = lfilter([0.0, a.sum() / 2, a.sum() / 2], a, np.ones(4000))
        settled = 0.05 * float(np.flatnonzero(np.abs(true - 1.0) > 0.05)[-1])
        found = step_response(data)
        figures = {f.name: f for f in found.figures}
        assert found.is_settled
        assert found.length_s > settled
        for name, right in (
            ("settling", settled),
            ("overshoot", 100 * (true.max() - 1)),
            ("final value", 1.0),
        ):
            figure = figures[name]
            assert figure.value is not None
            assert figure.low is not None
            assert figure.high is not None
            room = 0.5 * (figure.high - figure.low)  # one draw in twenty lies outside its interval
            assert figure.low - room <= right <= figure.high + room, name
        cut_off = step_response(data, horizon_s=2.0)
        assert all(f.value is None and "not settled within 2 s" in f.why for f in cut_off.figures)


def test_what_integrates_never_settles() -> None:
    rng = np.random.default_rng(8)
    u = np.repeat(rng.standard_normal(200), 20)
    y = np.cumsum(u) * 0.05
    data = Dataset.from_arrays(u, y + 0.1 * rng.standard_normal(len(y)), 0.05)
    assert all(f.value is None and "not settled" in f.why for f in step_response(data).figures)


def test_a_time_below_one_sample_is_a_bound() -> None:
    """A log of 9.9 Hz cannot show 20 ms: "below 0.2 s" is all that it tells."""
    rng = np.random.default_rng(9)
    u = np.repeat(rng.standard_normal(300), 8)
    y = lfilter([0.0, 1.0], [1.0], u) + 0.01 * rng.standard_normal(len(u))
    latency = step_response(Dataset.from_arrays(u, y, 0.101), horizon_s=2.0).figures[0]
    assert latency.value is None
    assert latency.high is not None
    assert latency.high >= 101.0
    assert str(latency).startswith("latency: below 1")


def test_a_few_taps_are_enough_for_a_response() -> None:
    """A log of 3 Hz: six taps in 2 s are fewer than a system of third order has coefficients."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.standard_normal(200), 3)
    y = lfilter([0.5], [1.0, -0.5], u) + 0.05 * rng.standard_normal(len(u))
    figures = {f.name: f for f in step_response(Dataset.from_arrays(u, y, 0.33)).figures}
    assert figures["final value"].value == pytest.approx(1.0, abs=0.1)


def test_times_and_overshoot_are_not_below_zero() -> None:
    """A rig without overshoot had one of [-0.004, 0.036] %; a latency within the first sample [0, 0] ms."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1.0, 1.0, 100), 50)
    y = lfilter([0.5], [1.0, -0.5], u) + 0.01 * rng.normal(size=len(u))
    figures = {
        f.name: f for f in step_response(Dataset.from_arrays(u[:, None], y, 0.02), horizon_s=1.0).figures
    }
    assert figures["overshoot"].low == 0.0
    assert figures["settling"].low is not None
    assert figures["settling"].low >= 0.0
    assert figures["latency"].high is not None
    assert figures["latency"].high >= 20.0


def _lightly_damped(rate_hz: float, seconds: float, noise: float) -> tuple[Dataset, FloatArray]:
    """A record of 3.4 rad/s and damping 0.13, and its step."""
    rng = np.random.default_rng(5)
    dt_s = 1.0 / rate_hz
    pole = 3.4 * (-0.13 + 1j * np.sqrt(1.0 - 0.13**2))
    a = np.real(np.poly(np.exp(np.array([pole, np.conj(pole)]) * dt_s)))
    b = [0.0, a.sum() / 2, a.sum() / 2]
    count = round(seconds * rate_hz)
    hold = round(0.6 * rate_hz)
    u = np.repeat(rng.standard_normal(count // hold + 1), hold)[:count]
    y = lfilter(b, a, u)
    data = Dataset.from_arrays(u, y + noise * y.std() * rng.standard_normal(count), dt_s, inputs=["u"])
    return data, np.asarray(lfilter(b, a, np.ones(count)))


def test_light_damping_is_followed_to_its_end(tmp_path: Path) -> None:
    """Longer responses were slowed down until two lengths contradicted each other: no figure was printed."""
    data, true = _lightly_damped(20.0, 180.0, 0.05)
    (segment,) = data.segments
    rows = np.column_stack([np.arange(len(segment)) * data.dt_s, segment.u, segment.y])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="time_s,u,y", comments="", fmt="%.9g")
    done = call("step", "log.csv", "--from", "u", "--to", "y", "--json", "-q", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (step,) = json.loads(done.stdout)["steps"]
    settled = data.dt_s * float(np.flatnonzero(np.abs(true - 1.0) > 0.05)[-1])
    found = step["figures"]["settling"]
    assert found["low"] - 0.5 < settled < found["high"] + 0.5
    assert step["figures"]["overshoot"]["value"] == pytest.approx(100.0 * (true.max() - 1.0), abs=5.0)


def test_a_slowed_down_response_is_that_of_the_log() -> None:
    """Five samples between taps: the mean was off by 5 % of the final value at its first swings."""
    data, true = _lightly_damped(50.0, 120.0, 0.001)
    found = step_response(data, horizon_s=20.0)
    assert found.time_s[1] == pytest.approx(5 * data.dt_s)
    assert np.abs(found.step - true[: 5 * len(found.step) : 5]).max() < 0.02


def test_a_response_without_overshoot_has_none() -> None:
    """The parabola through the last samples of one that never turns reached 12 % above it."""
    time_s = 0.1 * np.arange(40, dtype=np.float64)
    step: FloatArray = 1.0 - 0.6 * np.exp(-time_s / 0.3) - 2e-3 * (4.0 - time_s)
    curve = StepCurve(time_s, step, 1e-6 * np.eye(40), "")
    (overshoot,) = (f for f in curve.figures if f.name == "overshoot")
    assert overshoot.high is not None
    assert overshoot.high < 1.0


def test_an_input_that_never_moves_fast_leaves_no_wild_taps() -> None:
    """A slow chirp: what no frequency shows stays of the size of the response (it was 10^9 of it)."""
    rng = np.random.default_rng(4)
    time_s = 0.04 * np.arange(5000)
    u = np.sin(2.0 * np.pi * (0.02 * time_s + 0.5 * 0.006 * time_s**2))
    y = lfilter([0.0, 0.02], [1.0, -0.98], u)
    data = Dataset.from_arrays(u, y + 0.05 * y.std() * rng.standard_normal(len(u)), 0.04)
    found = step_response(data, horizon_s=8.0)
    assert np.abs(found.step).max() < 2.0
