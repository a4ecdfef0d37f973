"""ARX on plants whose truth is known: exact without noise, right in free run with it, clear when it fails."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, UsageError
from flysid.model.arx import ARX
from flysid.model.linear.difference_equation import FittedLinear
from tests import model_examples

# The paper's transfer functions (10) to (12)
PLANTS = {
    "longitudinal": ([0.7995], [1.0, 4.1881, 7.1429]),
    "lateral": ([116.24, 67.2488], [1000.0, 982.664, 301.338]),
    "vertical": ([17.6902, 37.7142, 422.62], [1.0, 11.6091, 68.394, 257.0, 684.244]),
}
ORDER = {"longitudinal": 2, "lateral": 2, "vertical": 4}
every_plant = pytest.mark.parametrize("plant", PLANTS)


def response(plant: str, u: FloatArray, dt_s: float) -> FloatArray:
    b, a, _ = cont2discrete(PLANTS[plant], dt_s, "zoh")
    return np.asarray(lfilter(b.ravel(), a.ravel(), u))


def sines(seconds: float, *rates: float) -> FloatArray:
    """Signals (13) and (14) of the same paper, at 100 Hz."""
    t = np.arange(int(seconds * 100)) * 0.01
    return np.asarray(sum(np.sin(w * t) for w in rates))


def steps(seconds: float, dt_s: float, seed: int) -> FloatArray:
    """A random telegraph signal, changing at most every 0.4 s."""
    hold = int(0.4 / dt_s)
    n = int(seconds / dt_s)
    return np.repeat(np.random.default_rng(seed).choice([-0.3, 0.3], n // hold + 1), hold)[:n]


def truth_error(model: FittedLinear, u: FloatArray, truth: FloatArray, noise: float) -> float:
    """RMSE of the free run against the noise-free truth, started from noisy measurements."""
    measured = truth + noise * np.random.default_rng(99).standard_normal(len(truth))
    n = model.n_init
    return float(np.sqrt(np.mean((model.simulate(u, measured[:n])[n:, 0] - truth[n:]) ** 2)))


@every_plant
def test_the_plants_order_is_exact_without_noise(plant: str) -> None:
    u = sines(400, 0.1, 0.2, 0.3, 0.4, 0.5)
    held = sines(400, 0.1, 0.2, 0.3, 0.4)
    n = ORDER[plant]
    train = Dataset.from_arrays(u, response(plant, u, 0.01), 0.01)
    model = ARX(na=n, nb=n, nk=1, refine=False).fit(train)
    assert truth_error(model, held, response(plant, held, 0.01), 0.0) < 1e-8


@every_plant
def test_defaults_free_run_within_a_tenth_of_the_noise(plant: str) -> None:
    dt = 0.02
    u = steps(120, dt, 1)
    held = steps(120, dt, 2)
    noisy = response(plant, u, dt) + 0.02 * np.random.default_rng(3).standard_normal(len(u))
    model = ARX().fit(Dataset.from_arrays(u, noisy, dt))
    assert truth_error(model, held, response(plant, held, dt), 0.02) < 0.002
    assert any("simulation error" in note for note in model.notes)


def test_the_papers_signals_with_noise_at_100_hz() -> None:
    """Least squares one step ahead is useless here; the defaults notice and refine."""
    u = sines(400, 0.1, 0.2, 0.3, 0.4, 0.5)
    held = sines(400, 0.1, 0.2, 0.3, 0.4)
    truth = response("lateral", held, 0.01)
    noisy = response("lateral", u, 0.01) + 0.02 * np.random.default_rng(4).standard_normal(len(u))
    train = Dataset.from_arrays(u, noisy, 0.01)
    plain = ARX(na=2, nb=2, nk=1, refine=False).fit(train)
    assert truth_error(plain, held, truth, 0.02) > 0.02
    assert truth_error(ARX().fit(train), held, truth, 0.02) < 0.005


def test_a_delay_is_found() -> None:
    u = steps(120, 0.02, 5)
    y = np.concatenate([np.zeros(6), response("longitudinal", u, 0.02)[:-6]])
    y = y + 0.005 * np.random.default_rng(6).standard_normal(len(u))
    model = ARX().fit(Dataset.from_arrays(u, y, 0.02))
    first = np.flatnonzero(model.system.b[:, 0, 0])[0]
    assert 6 <= first <= 8
    assert any("u -> y" in note for note in model.notes)


def test_equation_noise_is_left_to_least_squares() -> None:
    """Noise through 1/A: least squares is efficient, estimates lie within their errors."""
    rng = np.random.default_rng(7)
    u = rng.standard_normal(4000)
    drive = lfilter([0.0, 1.0, 0.5], [1.0], u) + 0.1 * rng.standard_normal(4000)
    y = lfilter([1.0], [1.0, -1.5, 0.7], drive)
    model = ARX(na=2, nb=2, nk=1, refine=False, offset=False).fit(Dataset.from_arrays(u, y, 0.1))
    estimates = model.flat[list(model.free)]
    miss = np.abs(estimates - [-1.5, 0.7, 1.0, 0.5]) / model.standard_errors[list(model.free)]
    assert miss.max() < 4.0
    assert model.standard_errors[list(model.free)].max() < 0.01


def test_coupled_outputs_are_exact_without_noise() -> None:
    train = model_examples.data(2, 2, noise=0.0)
    model = ARX(na=2, nb=1, nk=1, refine=False).fit(train)
    assert model.system.a[1] == pytest.approx(np.array([[-1.5, 0.0], [-0.1, -0.8]]), abs=1e-8)
    assert model.dc_gain == pytest.approx(np.array([[1.0, 0.2], [0.5, 1.6]]), abs=1e-6)
    held = model_examples.data(2, 2, noise=0.0, seed=9).segments[0]
    assert model.simulate(held.u, held.y[: model.n_init]) == pytest.approx(held.y, abs=1e-8)


def test_segments_are_not_joined() -> None:
    """Cutting the record where nothing is lost changes nothing but the rows at the cut."""
    whole = model_examples.data(noise=0.0)
    pieces = [s.slice(a, a + 100, whole.dt_s) for s in whole.segments for a in (0, 100, 200, 300)]
    settings = ARX(na=2, nb=1, nk=1, refine=False)
    cut = settings.fit(whole.with_segments(pieces))
    assert cut.flat == pytest.approx(settings.fit(whole).flat, abs=1e-9)


def test_from_rest_without_measured_outputs() -> None:
    u = steps(20, 0.02, 1)
    y = response("longitudinal", u, 0.02)
    model = ARX(na=2, nb=2, nk=1, refine=False).fit(Dataset.from_arrays(u, y, 0.02))
    assert model.simulate(u)[:, 0] == pytest.approx(y, abs=1e-9)


def test_printing_names_polynomials_errors_poles_and_choices() -> None:
    u = steps(120, 0.02, 1)
    y = response("longitudinal", u, 0.02) + 0.01 * np.random.default_rng(0).standard_normal(len(u))
    text = str(ARX(na=2).fit(Dataset.from_arrays(u, y, 0.02, inputs=["theta"], outputs=["v_x"])))
    for part in (
        "A[v_x, v_x] = 1 - 1.9",
        "+-",
        "rad/s, damping 0.7",
        "steady gain: theta -> v_x 0.11",
        "simulation error",
    ):
        assert part in text, text


def test_one_delay_for_every_input() -> None:
    with pytest.raises(UsageError, match="nk has 2 numbers for 1 input"):
        ARX(nk=(1, 2)).fit(model_examples.data())


def test_data_that_cannot_answer() -> None:
    rng = np.random.default_rng(0)
    y = rng.standard_normal(50)
    with pytest.raises(DataError, match="'u' never changes"):
        ARX().fit(Dataset.from_arrays(np.ones(50), y, 0.1))
    with pytest.raises(DataError, match="'y' never changes"):
        ARX().fit(Dataset.from_arrays(y, np.ones(50), 0.1))
    with pytest.raises(DataError, match="longer than the 30 samples"):
        ARX(na=30, nb=1, nk=1).fit(Dataset.from_arrays(y[:20], y[:20] ** 2, 0.1))
    with pytest.raises(DataError):
        ARX().fit(Dataset.from_arrays(y, y, 0.1).with_segments([]))


@pytest.mark.parametrize("samples", [2, 3, 5, 8, 13, 25])
def test_short_records_give_a_model_or_a_clear_error(samples: int) -> None:
    rng = np.random.default_rng(samples)
    data = Dataset.from_arrays(rng.standard_normal(samples), rng.standard_normal(samples), 0.1)
    with contextlib.suppress(DataError):
        assert np.isfinite(ARX().fit(data).simulate(data.segments[0].u)).all()


@pytest.mark.parametrize("samples", [2, 3, 4])
@pytest.mark.parametrize("settings", [ARX(), ARX(na=1, nb=1, nk=1), ARX(na=1, nb=1, nk=1, refine=False)])
def test_no_more_equations_than_unknowns_is_refused(settings: ARX, samples: int) -> None:
    rng = np.random.default_rng(samples)
    data = Dataset.from_arrays(rng.standard_normal(samples), rng.standard_normal(samples), 0.1)
    with pytest.raises(DataError, match="too few for 3 coefficients"):
        settings.fit(data)


def test_collinear_inputs_still_predict() -> None:
    train = model_examples.data()
    twice = Dataset.from_arrays(
        [np.hstack([s.u, 2 * s.u]) for s in train.segments], [s.y for s in train.segments], train.dt_s
    )
    model = ARX(na=2, nb=2, nk=1, refine=False).fit(twice)
    alone = ARX(na=2, nb=2, nk=1, refine=False).fit(train)
    segment = twice.segments[0]
    one = model.predict(segment.u, segment.y)
    other = alone.predict(segment.u[:, :1], segment.y)
    assert one[2:] == pytest.approx(other[2:], abs=1e-8)


@pytest.mark.parametrize(("zero", "said"), [(0.9905, True), (0.95, False)])
def test_a_pole_that_a_zero_nearly_cancels_is_told_as_such(zero: float, said: bool) -> None:
    """Its time constant was printed as the plant's slowest: 14 s of a plant that settles within one."""
    u = np.random.default_rng(5).normal(size=3000)
    y = lfilter([0.0, 0.1, -0.1 * zero], np.convolve([1.0, -0.9], [1.0, -0.99]), u)
    model = ARX(na=2, nb=2, nk=1, refine=False).fit(Dataset.from_arrays([u], [y], 0.01))
    (line,) = [line for line in str(model).splitlines() if line.startswith("poles: ")]
    slow, fast = sorted(line.removeprefix("poles: ").split("; "), key=lambda mode: "0.995" not in mode)
    assert ("nearly cancels" in slow) == said
    assert "nearly cancels" not in fast


def test_a_control_system_with_offsets_does_what_the_model_does() -> None:
    import control

    rng = np.random.default_rng(0)
    u = 2.0 + rng.normal(size=(300, 2))
    y = lfilter([0.0, 0.5], [1.0, -0.8], u[:, 0] - 0.6 * u[:, 1]) + 0.7
    model = ARX(na=1, nb=1, nk=1).fit(Dataset.from_arrays(u, y, 0.1))
    system = model.to_control("ss", offsets=True)
    assert system.input_labels == ["u1", "u2", "one"]
    _, found = control.forced_response(system, U=np.column_stack([u, np.ones(300)]).T)
    np.testing.assert_allclose(np.ravel(found), model.simulate(u)[:, 0], atol=1e-9)
