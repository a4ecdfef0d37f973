"""TF: the paper's plants come back with intervals, whatever the noise, the delay or the drift."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import flysid
from flysid.dataset import Dataset
from flysid.errors import DataError, FitError, UsageError
from flysid.model.frequency.continuous_transfer import ContinuousTransfer, TransferEstimate
from flysid.model.transfer_function import TF, FittedTF
from tests.model.linear.test_transfer import PLANTS, experiment


@pytest.mark.parametrize("plant", ["longitudinal", "lateral"])
def test_without_noise_the_plant_comes_back(plant: str) -> None:
    num, den = PLANTS[plant]
    found = TF(poles=2, zeros=len(num) - 1).fit(experiment(plant, 0.05, 0.0)).transfer()
    assert found.denominator == pytest.approx(np.array(den), rel=1e-5)
    assert found.numerator == pytest.approx(np.array(num), rel=1e-5)
    assert found.dead_time_s == pytest.approx(0.0, abs=1e-6)


def test_orders_and_dead_time_are_chosen() -> None:
    model = TF().fit(experiment("longitudinal", 0.05, 0.005, delay=3))
    found = model.transfer()
    assert len(found.denominator) == 3
    assert found.dead_time_s == pytest.approx(0.15, abs=0.02)
    low, high = found.dead_time.interval
    assert low < 0.15 < high
    assert "BIC" in model.notes[0]
    assert "dead time estimated" in model.notes[0]


def fitted(seed: int) -> FittedTF:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 150), 4)
    b, a, _ = cont2discrete(PLANTS["longitudinal"], 0.05, "zoh")
    coloured = lfilter([1.0], [1.0, -0.8], 0.003 * rng.standard_normal(len(u)))
    data = Dataset.from_arrays(u, lfilter(b.ravel(), a.ravel(), u) + coloured, 0.05)
    return TF(poles=2, zeros=0, dead_time_s=0.0).fit(data, data)


def test_a_dead_time_is_as_unsure_as_it_scatters() -> None:
    """Over 16 flights; a pole's or a gain's interval in its place is several times as wide, or as narrow."""
    b, a, _ = cont2discrete(([3.0], [1.0, 2.0]), 0.05, "zoh")
    found = []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.choice([-1.0, 1.0], 120), 5)
        y = lfilter(np.append(np.zeros(2), b.ravel()), a.ravel(), u) + 0.05 * rng.standard_normal(len(u))
        model = TF(poles=1, zeros=0, dead_time_s=(None,)).fit(Dataset.from_arrays(u, y, 0.05))
        found.append(model.transfer().dead_time)
    scatter = np.std([f.value for f in found], ddof=1)
    claimed = np.mean([f.error for f in found])
    assert 0.6 < scatter / claimed < 1.6


def test_an_offset_is_found_without_refinement() -> None:
    """A flight that begins far from where its inputs lead: its means are not those of a steady state."""
    rng = np.random.default_rng(3)
    u = 4.0 + np.repeat(rng.choice([-1.0, 1.0], 200), 4)
    b, a, _ = cont2discrete(([3.0], [1.0, 0.5]), 0.05, "zoh")
    y = 7.0 + lfilter(b.ravel(), a.ravel(), u)
    model = TF(poles=1, zeros=0, dead_time_s=0.0, refine=False).fit(Dataset.from_arrays(u, y, 0.05))
    free_run = model.simulate(u[:, None], y[: model.n_init, None])[:, 0]
    assert np.sqrt(np.mean((free_run - y) ** 2)) < 0.04 * y.std()


def test_intervals_hold_the_truth_in_coloured_noise() -> None:
    """16 flights, 6 figures each; the larger campaign is bench/frequency_coverage.py."""
    num, den = PLANTS["longitudinal"]
    size = np.sqrt(den[2])
    truth = [num[0], den[1], den[2], num[0] / den[2], size, den[1] / 2 / size]
    inside = []
    for seed in range(16):
        t = fitted(seed).transfer()
        mode = t.modes[0]
        values = [
            t.numerator[0],
            *t.denominator[1:],
            t.gain.value,
            mode.frequency_rad_s.value,
            mode.damping.value,
        ]
        errors = [*t.errors[:3], t.gain.error, mode.frequency_rad_s.error, mode.damping.error]
        inside.append(np.abs(np.subtract(values, truth)) < 1.96 * np.array(errors))
    assert np.mean(inside) > 0.85


def test_bands_are_those_of_the_transfer_function() -> None:
    model = fitted(0)
    omega = np.array([0.5, 2.0, 5.0])
    discrete = model.frequency_response(omega)
    log_gain, phase = model.transfer().error_at(omega)
    assert discrete.magnitude_error[:, 0, 0] / np.abs(discrete.response[:, 0, 0]) == pytest.approx(
        log_gain, rel=0.05
    )
    assert discrete.phase_error[:, 0, 0] == pytest.approx(phase, rel=0.05)
    low, high = model.simulation_band(np.ones((80, 1)), draws=60)
    gain = model.transfer().gain
    assert (high - low)[-1, 0] == pytest.approx(2 * 1.96 * gain.error, rel=0.4)


def test_printed_like_the_paper_prints_it() -> None:
    text = str(fitted(0))
    for part in (
        "y / u =",
        "s^2 + 4.",
        "s + 7.",
        "+-",
        "steady gain: 0.11",
        "rad/s, damping 0.7",
        "95 % interval",
    ):
        assert part in text


def test_to_control_and_back_without_loss() -> None:
    model = fitted(0)
    whole = model.transfer()
    system = whole.to_control()
    assert np.array_equal(system.num[0][0], whole.numerator)
    assert np.array_equal(system.den[0][0], whole.denominator)
    u = np.random.default_rng(0).standard_normal(200)
    sampled_here = model.to_control()
    assert sampled_here.dt == model.dt_s
    step = control.forced_response(sampled_here, U=u).outputs
    rest = lfilter(model.system.b[:, 0, 0], model.system.a[:, 0, 0], u)
    assert np.asarray(step) == pytest.approx(rest, abs=1e-12)
    late = (
        TF(poles=2, zeros=0, dead_time_s=0.15)
        .fit(experiment("longitudinal", 0.05, 0.001, delay=3))
        .transfer()
    )
    with pytest.raises(UsageError, match="dead time"):
        late.to_control()
    near = late.to_control(pade=3)
    assert complex(near(1j)) == pytest.approx(complex(late.at(np.array([1.0]))[0]), rel=1e-3)


def drifting() -> Dataset:
    """Three segments, each with its own offset and drift."""
    rng = np.random.default_rng(5)
    b, a, _ = cont2discrete(PLANTS["longitudinal"], 0.05, "zoh")
    us = []
    ys = []
    for slope in (0.02, -0.03, 0.01):
        u = np.repeat(rng.choice([-1.0, 1.0], 100), 6) + 0.3
        t = 0.05 * np.arange(len(u))
        ys.append(
            lfilter(b.ravel(), a.ravel(), u) + slope * t + 10 * slope + 0.002 * rng.standard_normal(len(u))
        )
        us.append(u)
    return Dataset.from_arrays(us, ys, 0.05)


def test_drift_is_removed_or_estimated_on_request() -> None:
    num, den = PLANTS["longitudinal"]
    truth = np.array([*num, *den[1:]])
    misses = {}
    for trend in ("none", "remove", "estimate"):
        t = TF(poles=2, zeros=0, dead_time_s=0.0, trend=trend).fit(drifting(), drifting()).transfer()
        misses[trend] = float(np.abs(np.append(t.numerator, t.denominator[1:]) / truth - 1.0).max())
    assert misses["estimate"] < 0.05
    assert misses["remove"] < 0.1
    assert misses["none"] > 3 * misses["estimate"]


def test_a_model_of_measured_signals_holds_them_straight() -> None:
    rng = np.random.default_rng(6)
    fine = lfilter([0.02], [1.0, -0.98], rng.standard_normal(20000))
    b, a, _ = cont2discrete(PLANTS["longitudinal"], 0.005, "foh")
    y = lfilter(b.ravel(), a.ravel(), fine)
    data = Dataset.from_arrays(fine[::10], y[::10], 0.05)
    first, zero = (
        TF(poles=2, zeros=0, dead_time_s=0.0, hold=h).fit(data).transfer() for h in ("first", "zero")
    )
    miss = [abs(t.denominator[1] / PLANTS["longitudinal"][1][1] - 1.0) for t in (first, zero)]
    assert miss[0] < 0.02
    assert miss[0] < 0.3 * miss[1]


def test_an_unstable_estimate_is_named() -> None:
    rng = np.random.default_rng(3)
    r = np.repeat(rng.standard_normal(600), 10)
    y = np.zeros(6000)
    u = np.zeros(6000)
    pole = np.exp(0.5 * 0.02)
    for k in range(6000):
        if k:
            y[k] = pole * y[k - 1] + 4.0 * (pole - 1.0) * u[k - 1]
        u[k] = r[k] - 2.0 * y[k]
    model = TF(poles=1, zeros=0, dead_time_s=0.0, stable=False).fit(Dataset.from_arrays(u, y, 0.02))
    assert not model.is_stable
    assert any("Unstable: a pole at +0.5" in note for note in model.notes)
    assert "doubles in" in str(model)
    held = TF(poles=1, zeros=0, dead_time_s=0.0).fit(Dataset.from_arrays(u, y, 0.02))
    assert held.is_stable


def test_bad_data_and_settings_are_named() -> None:
    rng = np.random.default_rng(0)
    moving = rng.standard_normal(400)
    with pytest.raises(DataError, match="never changes"):
        TF().fit(Dataset.from_arrays(np.zeros(400), moving, 0.1))
    with pytest.raises((DataError, FitError), match=r"too (short|few)"):
        TF().fit(Dataset.from_arrays(moving[:8], moving[:8] ** 2, 0.1))
    with pytest.raises(DataError, match="at too few frequencies"):
        TF(refine=False).fit(Dataset.from_arrays(moving, rng.standard_normal(400), 0.1))
    good = Dataset.from_arrays(moving, moving, 0.1)
    for settings in (TF(poles=1, zeros=2), TF(poles=2, zeros=(0, 0)), TF(dead_time_s=-1.0)):
        with pytest.raises(UsageError):
            settings.fit(good)


def test_noise_alone_gives_a_model_whose_intervals_say_so() -> None:
    rng = np.random.default_rng(1)
    data = Dataset.from_arrays(rng.standard_normal(400), rng.standard_normal(400), 0.1)
    model = TF(poles=1, zeros=0, dead_time_s=0.0).fit(data)
    low, high = model.transfer().gain.interval
    assert low < 0.0 < high


def test_the_public_name() -> None:
    assert flysid.TF is TF


def test_a_static_gain_with_a_dead_time_is_found_as_one() -> None:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], 200), 6) + 0.1 * rng.standard_normal(1200)
    y = 2.5 * np.concatenate([np.zeros(4), u[:-4]]) + 0.3 + 0.05 * rng.standard_normal(1200)
    data = Dataset.from_arrays(u, y, 0.05)
    for settings in (TF(), TF(poles=0)):
        found = settings.fit(data).transfer()
        assert len(found.denominator) == 1
        assert found.numerator[0] == pytest.approx(2.5, abs=3 * found.numerator_error[0])
        assert found.dead_time_s == pytest.approx(0.2)
        assert "\n1\n" not in str(found)
    with pytest.raises(UsageError, match="nk_hint"):
        TF(nk_hint=(1, 2)).fit(data)


def test_an_interval_ends_where_the_truth_must() -> None:
    assert str(TransferEstimate(0.5, 0.1)) == "0.5 +- 0.2"
    assert str(TransferEstimate(0.05, 0.1, least=0.0)) == "0.05 [0, 0.25]"
    loose = ContinuousTransfer(
        np.array([2.0]), np.array([1.0, 2.0]), np.diag([0.1, 1.5, 0.04]), 0.1, "u", "y"
    )
    assert loose.dead_time.interval[0] == 0.0
    assert "e^(-0.1 [0, 0.49] s)" in str(loose)
    (mode,) = loose.modes
    assert mode.frequency_rad_s.interval[0] == 0.0
    assert mode.time_constant_s is not None
    assert mode.time_constant_s.interval[0] == 0.0
