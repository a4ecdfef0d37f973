"""Figures of loops against their closed form, and refusals where a record cannot tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from bench.closed_loop import Loop, direct
from bench.loop_margins import flown, truth
from bench.truth.records import draw_record
from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import UsageError
from flysid.model.frequency.loop_curve import LoopCurve
from flysid.model.frequency.loop_figures import broken_loop, command_figures, loop_figures
from flysid.model.frequency.rational import Rational
from flysid.model.frequency.response import MeasuredResponse, measure_response
from flysid.model.frequency.sampling import sample
from flysid.model.transfer_function import TF
from flysid.validate.compare.condition import matching_channels
from flysid.validate.transfers.identify import figures_document, identify_channel


def test_margins_of_an_integrator_with_dead_time() -> None:
    true = truth()
    found = {f.name: f for f in loop_figures(broken_loop(flown(3), reference="r", at="input"))}
    assert set(found) == set(true)
    for name, right in true.items():
        figure = found[name]
        assert figure.value is not None
        assert figure.low is not None
        assert figure.high is not None
        assert figure.low < figure.value < figure.high
        assert abs(figure.value - right) < 2.0 * (figure.high - figure.low)
    assert found["phase_margin_deg"].value == pytest.approx(true["phase_margin_deg"], abs=1.0)
    assert found["crossover_rads"].value == pytest.approx(true["crossover_rads"], rel=0.02)


def test_the_same_loop_from_its_setpoint() -> None:
    """u = r - y: the reference may as well be called a setpoint; L is the same."""
    data = flown(4)
    added = broken_loop(data, reference="r", at="input")
    named = broken_loop(data, reference="r", at="setpoint")
    np.testing.assert_allclose(added.response, named.response, rtol=1e-9)


def test_bandwidth_of_a_second_order_loop() -> None:
    """9 rad/s, damping 0.5: -3 dB at 11.4 rad/s, peak 1.25 dB; the phase stays above -180 degrees."""
    rng = np.random.default_rng(0)
    dt_s = 0.01
    omega = 9.0
    n = 8000
    u = np.repeat(rng.standard_normal(n // 20), 20)
    s = omega * np.array([-0.5 + 1j * np.sqrt(0.75), -0.5 - 1j * np.sqrt(0.75)])
    a = np.real(np.poly(np.exp(s * dt_s)))
    y = np.asarray(lfilter([0.0, a.sum() / 2, a.sum() / 2], a, u)) + 0.01 * rng.standard_normal(n)
    found = {f.name: f for f in command_figures(measure_response(Dataset.from_arrays(u, y, dt_s)))}
    assert found["bandwidth_rads"].value == pytest.approx(omega * 1.272, rel=0.05)
    assert found["peak_db"].value == pytest.approx(1.25, abs=0.3)
    # a peak does not depend on the unit of the input
    in_deg = measure_response(Dataset.from_arrays(np.degrees(u), y, dt_s))
    again = {f.name: f for f in command_figures(in_deg)}
    assert again["peak_db"].value == pytest.approx(found["peak_db"].value, abs=1e-6)


def test_a_record_that_cannot_tell_is_refused() -> None:
    data = Loop(0.2, rate_hz=100.0, seconds=30.0).flown(1)
    alone = direct(data)
    with pytest.raises(UsageError, match="margins belong to the loop cut open"):
        identify_channel("rate", alone, TF(poles=1, zeros=0, dead_time_s=0.0), "setpoint")
    with pytest.raises(UsageError, match="no input is called 'chirp'"):
        broken_loop(alone, reference="chirp", at="input")
    quiet = Dataset.from_arrays(
        [s.u * [1.0, 1e-4] for s in data.segments],
        [s.y for s in data.segments],
        data.dt_s,
        inputs=["u", "chirp"],
    )
    rng = np.random.default_rng(0)
    noise = Dataset.from_arrays(
        [np.column_stack([s.u[:, 0], rng.standard_normal(len(s))]) for s in quiet.segments],
        [s.y for s in quiet.segments],
        data.dt_s,
        inputs=["u", "r"],
    )
    figures = loop_figures(broken_loop(noise, reference="r", at="setpoint"))
    assert all(f.value is None and f.why for f in figures if "margin" in f.name)


def test_figures_guard_a_pipeline() -> None:
    data = Loop(0.1, rate_hz=100.0).flown(2)
    channel = identify_channel("rate", data, TF(poles=2, zeros=0, reference=["chirp"]), "input")
    assert "loop: crossover: " in "\n".join(channel.lines())
    document = figures_document([channel])
    margin = channel.to_dict()["figures"]["loop"]["phase_margin_deg"]
    assert margin["low"] < margin["value"] < margin["high"]
    assert matching_channels(f"loop.phase_margin_deg.low < {margin['low'] + 1.0}", document) == {"rate": ""}
    assert matching_channels(f"loop.phase_margin_deg.high < {margin['low']}", document) == {}
    assert matching_channels("command.bandwidth_rads.value < 0", document)  # not to be told: a guard fails


def test_no_interval_reaches_where_the_truth_cannot_be() -> None:
    """Of noisy records intervals of first order reached to margins below 0, and to |S| below 1."""
    low = {"gain_margin_db": 0.0, "phase_margin_deg": 0.0, "sensitivity_peak_db": 0.0}
    for seed in range(3):
        loop = broken_loop(flown(seed, snr_db=5.0), reference="r", at="input")
        loose = replace(loop, error=30.0 * loop.error)
        for figure in loop_figures(loose):
            if figure.name in low and figure.value is not None:
                assert figure.low is not None
                assert low[figure.name] <= figure.low <= figure.value


def test_a_noisy_low_end_is_no_bandwidth() -> None:
    """Drift at low frequency crosses -3 dB again and again; 0.6 rad/s was printed for a loop of 9.8."""
    right = 9.53  # of 75 / (s^2 + 11 s + 75)
    a, (b,) = sample(Rational(np.array([1.0, 11.0, 75.0]), (np.array([75.0]),), np.zeros(1)), 0.02, "zero")
    printed = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.standard_normal(500), 12)
        drift = lfilter([1.0], [1.0, -0.995], rng.standard_normal(len(u)))
        y = lfilter(b, a, u)
        data = Dataset.from_arrays(u, y + 0.3 * y.std() * drift / drift.std(), 0.02)
        (found,) = [f for f in command_figures(measure_response(data)) if f.name == "bandwidth_rads"]
        if found.low is not None and found.high is not None:
            printed.append(found.low <= right <= found.high)
            assert found.low > 0.4 * right
    assert len(printed) >= 3
    assert sum(printed) >= len(printed) - 1


def test_an_integrator_has_no_bandwidth() -> None:
    rng = np.random.default_rng(1)
    u = np.repeat(rng.standard_normal(300), 10)
    y = np.cumsum(u) * 0.02
    data = Dataset.from_arrays(u, y + 0.1 * rng.standard_normal(len(y)), 0.02)
    (found,) = [f for f in command_figures(measure_response(data)) if f.name == "bandwidth_rads"]
    assert found.value is None
    assert "not shown to be flat" in found.why


def test_a_crossing_that_may_come_back_is_not_the_last() -> None:
    """A resonance that may or may not reach 1 beyond the crossing: 0.24 was printed for 2.93 rad/s."""
    record = draw_record(700100237, "loops")
    found = loop_figures(broken_loop(record.data, reference="r", at=record.reference))
    crossover = found[0]
    assert crossover.value is None
    assert "may once more by" in crossover.why


def test_nothing_is_read_beyond_the_last_line_of_a_multisine() -> None:
    """There its lower lines were taken for a constant: a peak of S of 0.07 dB was printed for 5.1."""
    record = draw_record(700100224, "loops")
    found = loop_figures(broken_loop(record.data, reference="r", at=record.reference))
    assert found[3].name == "sensitivity_peak_db"
    assert found[3].value is None


def test_what_flew_has_no_negative_margin() -> None:
    """A reference that enters elsewhere, or in another unit, gives a loop that would have fallen."""
    loop = broken_loop(flown(3), reference="r", at="input")
    found = {f.name: f for f in loop_figures(replace(loop, response=30.0 * loop.response))}
    assert found["gain_margin_db"].value is None
    assert "below 0, which no loop has that flew" in found["gain_margin_db"].why


def test_the_peak_of_a_noisy_curve_is_not_its_highest_point() -> None:
    """Ms held in 49 of 62 records, and every miss was too high."""
    right = truth()["sensitivity_peak_db"]
    signs = []
    for seed in range(8):
        figures = loop_figures(broken_loop(flown(seed, snr_db=12.0), reference="r", at="input"))
        (found,) = [f for f in figures if f.name == "sensitivity_peak_db"]
        assert found.value is not None
        assert found.low is not None
        assert found.high is not None
        assert found.low - 0.1 <= right <= found.high + 0.1
        signs.append(found.value > right)
    assert 0 < sum(signs) < len(signs)


def drawn_curve(level: FloatArray, phase: FloatArray) -> MeasuredResponse:
    """A response known to a per cent everywhere between 0.1 and 10 rad/s: ln |G| and phase in rad."""
    count = len(level)
    return MeasuredResponse(
        omega=np.geomspace(0.1, 10.0, count),
        response=np.exp(level + 1j * phase)[:, None],
        coherence=np.full((count, 1), 0.99),
        error=np.full((count, 1), 0.005),
        averages=np.full((count, 1), 50.0),
        freedom=np.full(count, 100.0),
        correlation=np.eye(count)[None],
        shared=0.0,
        dt_s=0.01,
        inputs=(Signal("u"),),
        output=Signal("y"),
    )


@pytest.mark.parametrize("degrees", [-260.0, -181.0, -1.0, 80.0])
def test_a_phase_begins_between_minus_270_and_90_degrees(degrees: float) -> None:
    """Whatever turn the angle of a complex number is given in."""
    phase = np.radians(np.linspace(degrees, degrees - 30.0, 60))
    for turns in (-1, 0, 1):
        curve = LoopCurve.of(drawn_curve(np.zeros(60), phase + 2.0 * np.pi * turns), 0)
        assert isinstance(curve, LoopCurve)
        np.testing.assert_allclose(np.degrees(curve.own.imag[[0, -1]]), [degrees, degrees - 30.0], atol=0.1)


def test_bandwidth_by_phase_is_where_the_phase_passes_first() -> None:
    """Three times it passes -135 degrees: at 0.45, 1 and 2.2 rad/s."""
    x = np.linspace(-1.0, 1.0, 200)
    phase = -0.75 * np.pi - 4.0 * x * (x**2 - 0.35**2)
    found = {f.name: f for f in command_figures(drawn_curve(np.zeros(200), phase))}
    assert found["bandwidth_phase_rads"].value == pytest.approx(10.0**-0.35, rel=0.05)
