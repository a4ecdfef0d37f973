"""Closed loops are recognised, open ones left alone, whatever the input looks like."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import LOWPASS, Dataset, FloatArray
from flysid.errors import UsageError
from flysid.feedback import feedback
from flysid.ingest.align.resample import lowpass
from flysid.model.oe import OE
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.cautions import cautions
from flysid.validate.diagnose.diagnostics import diagnose
from tests.fakes import FirstOrder
from tests.model.linear.test_frequency_response import DT_S, A, B, chirp, steps

N = 3000


def disturbed(rng: np.random.Generator) -> FloatArray:
    return np.asarray(lfilter([1.0], [1.0, -0.95], 0.01 * rng.standard_normal(N)))


def open_loop(kind: str, seed: int) -> Dataset:
    rng = np.random.default_rng(seed)
    t = np.arange(N) * DT_S
    u = {
        "chirp": chirp(N, 0.1, 3.0),
        "multisine": sum(
            np.sin(w * t + p) for w, p in zip((0.5, 1.1, 2.3, 4.1), rng.uniform(0, 6, 4), strict=True)
        ),
        "smooth": lfilter([0.02], [1.0, -0.98], rng.standard_normal(N)),
        "steps": steps(N, rng),
    }[kind]
    return Dataset.from_arrays(np.asarray(u), lfilter(B.ravel(), A, u) + disturbed(rng), DT_S)


def closed_loop(gain: float, lag: int, seed: int) -> Dataset:
    """u(k) = r(k) - gain y(k - lag)."""
    rng = np.random.default_rng(seed)
    b = B.ravel()
    a = A
    v = disturbed(rng)
    r = 0.5 * steps(N, rng, 25)
    x = np.zeros(N)
    y = np.zeros(N)
    u = np.zeros(N)
    for k in range(2, N):
        x[k] = -a[1] * x[k - 1] - a[2] * x[k - 2] + b[1] * u[k - 1] + b[2] * u[k - 2]
        y[k] = x[k] + v[k]
        u[k] = r[k] - gain * y[max(k - lag, 0)]
    return Dataset.from_arrays(u, y, DT_S, inputs=["theta"], outputs=["v_x"])


def test_how_much_of_an_answer_matters_is_a_setting() -> None:
    data = closed_loop(5.0, 2, 0)
    (plain,) = feedback(data)
    assert plain.closed
    assert not feedback(data, matters=min(1.0, 1.01 * plain.share))[0].closed
    smooth = replace(data, segments=tuple(replace(s, marks={LOWPASS: 5.0}) for s in data.segments))
    assert feedback(smooth, matters=0.1, passed=0.3)[0].matters == pytest.approx(0.03)
    with pytest.raises(UsageError, match="matters is 0"):
        feedback(data, matters=0.0)


@pytest.mark.parametrize("kind", ["chirp", "multisine", "smooth", "steps"])
def test_an_open_loop_is_left_alone(kind: str) -> None:
    for seed in range(2):
        data = open_loop(kind, seed)
        (found,) = feedback(data)
        assert not found.closed
        assert found.words == ""
        assert found.p_value > 1e-3


@pytest.mark.parametrize(("gain", "lag"), [(5.0, 2), (3.0, 15)])
def test_a_controller_and_a_slow_pilot_are_recognised(gain: float, lag: int) -> None:
    data = closed_loop(gain, lag, 0)
    (found,) = feedback(data)
    assert found.closed
    assert found.words.startswith("theta reacts to v_x: within 0.5 s after")
    assert "IV with the reference" in found.words


def test_a_nonlinear_plant_in_open_loop_is_no_feedback() -> None:
    rng = np.random.default_rng(0)
    u = steps(N, rng)
    y = FirstOrder(a=0.97, b=0.05, d=-0.02, dt_s=DT_S).simulate(u[:, None], np.zeros((1, 1)))[:, 0]
    data = Dataset.from_arrays(u, y + disturbed(rng), DT_S)
    assert not feedback(data)[0].closed


@pytest.mark.parametrize("hertz", [10, 20])
def test_what_moves_between_the_samples_of_a_log_is_no_feedback(hertz: int) -> None:
    """A quick attitude loop under smooth commands, logged slowly, with next to no noise."""
    rng = np.random.default_rng(3)
    dt_s = 1 / 400
    u = lfilter([1.0], np.poly([0.98, 0.98]), rng.standard_normal(400 * 60))
    y = lfilter([0.0, 1.0], [1.0, -2.0 + 14.0 * dt_s, 1.0 - 14.0 * dt_s + 100.0 * dt_s**2], u)
    y = y / y.std() + 0.001 * rng.standard_normal(len(y))
    every = 400 // hertz
    data = Dataset.from_arrays(u[::every] / u.std(), y[::every], every * dt_s)
    assert not feedback(data)[0].closed


@pytest.mark.parametrize("noise", [0.02, 0.001])
def test_a_setpoint_logged_slower_than_the_output_is_no_feedback(noise: float) -> None:
    rng = np.random.default_rng(3)
    u = lfilter([1.0], np.poly([0.98, 0.98]), rng.standard_normal(N))
    y = lfilter([0.0, 0.15], [1.0, -0.85], u)
    y = y + noise * y.std() * rng.standard_normal(N)
    assert not feedback(Dataset.from_arrays(held(u, 5), y, DT_S))[0].closed


@pytest.mark.parametrize("first", [0, 3])
def test_a_pilot_is_recognised_in_a_log_that_holds_the_stick(first: int) -> None:
    (whole,) = closed_loop(3.0, 15, 0).segments
    assert feedback(Dataset.from_arrays(held(whole.u[:, 0], 5)[first:], whole.y[first:], DT_S))[0].closed


def held(u: FloatArray, samples: int) -> FloatArray:
    """What a log holds of a signal (N,) that it gets every so many samples."""
    return np.repeat(u[::samples], samples)[: len(u)]


def low_passed(seed: int, gain: float, *, late: int = 8, ratio: int = 2, every: int = 2) -> Dataset:
    """A lag of 0.1 s, 100 samples a second behind the loader's low-pass, on a grid of 50 Hz.

    Commands come every so many samples, white, less `gain` times the output of `late` samples before. The
    output drifts and has noise of its own.
    """
    rng = np.random.default_rng(seed)
    count = 100 * 60
    drift = lfilter([0.02], [1.0, -0.98], rng.standard_normal(count))
    command, grain = rng.standard_normal((2, count))
    u, x, y = (np.zeros(count) for _ in range(3))
    for k in range(count):
        x[k] = 0.905 * x[k - 1] + 0.095 * u[k - 1]
        y[k] = x[k] + (3.0 if gain else 0.02) * drift[k] + 0.005 * grain[k]
        u[k] = u[k - 1] if k % every else command[k] - gain * y[k - late]
    slow_u, slow_y = (np.convolve(s, lowpass(ratio), mode="valid")[::ratio] for s in (u, y))
    data = Dataset.from_arrays(slow_u, slow_y, ratio / 100.0)
    return data.with_segments([replace(s, marks={LOWPASS: float(ratio)}) for s in data.segments])


def test_a_low_pass_that_looks_ahead_is_no_feedback() -> None:
    """White commands at the grid's rate showed a reaction of 30 to 70 % where there was little noise."""
    assert not feedback(low_passed(0, 0.0))[0].closed


def test_a_loop_is_seen_through_the_low_pass() -> None:
    assert feedback(low_passed(1, 2.0))[0].closed


def test_of_a_fast_log_samples_are_taken_apart() -> None:
    data = closed_loop(3.0, 15, 0)  # 50 Hz
    held = Dataset.from_arrays(
        np.repeat(data.segments[0].u, 10, axis=0), np.repeat(data.segments[0].y, 10, axis=0), data.dt_s / 10
    )
    (slow,), (fast,) = feedback(data), feedback(held)
    assert fast.share == pytest.approx(slow.share, rel=1e-9)


def test_a_record_without_noise_is_no_feedback() -> None:
    """What small directions of the regressors would explain was taken for a reaction: 99 % of nothing."""
    time_s = DT_S * np.arange(N)
    u = np.sin(2.0 * np.pi * (0.02 + 0.004 * time_s) * time_s)
    y = lfilter([0.0, 0.05], [1.0, -0.95], u)
    assert not feedback(Dataset.from_arrays(u, y, DT_S))[0].closed


def test_too_little_data_say_nothing() -> None:
    data = open_loop("steps", 0)
    short = data.with_segments([data.segments[0].slice(0, 60, DT_S)])
    (found,) = feedback(short)
    assert found.p_value == 1.0
    assert not found.closed


@pytest.mark.parametrize(("gain", "lag"), [(0.0, 1), (3.0, 15)])
def test_the_report_says_it_as_the_fit_says_it(gain: float, lag: int) -> None:
    """One rule in one place; and nothing is said in open loop."""
    data = closed_loop(gain, lag, 0)
    model = OE(na=2, nb=2, nk=1).fit(data)
    (found,) = feedback(data)
    c = compare([model], data, baseline=None)
    said = [x.text for x in cautions({"roll": c}, {"roll": diagnose(c, data)})]
    assert found.closed == bool(gain)
    assert any(x.startswith("theta reacts to v_x: within") for x in said) == bool(gain)
