"""Output error: the noise floor is reached, and the linear figures of public benchmarks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from bench.verdict_fairness import flights, linear_plant
from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError
from flysid.model.arx import ARX
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.output_error import raise_order
from flysid.model.noise import burg, noise_model
from flysid.model.oe import OE
from flysid.model.polynomials import polynomial_text
from flysid.model.simulation_error import OutputError, OutputOrders, Record, from_transfer, to_transfer

BENCHMARKS = Path(__file__).parents[4] / "shared" / "benchmarks"


def benchmark(name: str) -> Path:
    path = BENCHMARKS / name
    if not path.exists():
        pytest.skip(f"{name} is not beside the repository (../shared/benchmarks)")
    return path


def held_out_rmse(model: FittedLinear, u: FloatArray, y: FloatArray, n_init: int = 0) -> FloatArray:
    start = max(n_init, model.n_init)
    run = model.simulate(u, y[: model.n_init])
    return np.asarray(np.sqrt(np.mean((run - y)[start:] ** 2, axis=0)))


def problem(seed: int, n_u: int) -> tuple[OutputError, FloatArray]:
    rng = np.random.default_rng(seed)
    orders = OutputOrders(3, (2,) * n_u, (1, 0)[:n_u])
    theta = rng.standard_normal(orders.count) * 0.2
    stable = replace(
        to_transfer(theta, orders),
        a=np.asarray(np.real(np.poly([0.9, 0.7 + 0.3j, 0.7 - 0.3j])), dtype=np.float64),
    )
    theta[:3] = from_transfer(stable, orders)[:3]
    records = tuple(Record(rng.standard_normal((n, n_u)), rng.standard_normal(n)) for n in (40, 60))
    return OutputError(records, orders), theta


@pytest.mark.parametrize("n_u", [1, 2])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_sensitivities_equal_differences(seed: int, n_u: int) -> None:
    """Up to the Kaufman approximation: the gradient of the cost, which it leaves exact, is compared."""
    p, theta = problem(seed, n_u)
    residual, jacobian = p.residuals_and_jacobian(theta)
    gradient = 2 * jacobian.T @ residual
    for i in range(len(theta)):
        step = np.zeros(len(theta))
        step[i] = 1e-6
        slope = (p.cost(theta + step) - p.cost(theta - step)) / 2e-6
        assert gradient[i] == pytest.approx(slope, rel=1e-4, abs=1e-4 * np.abs(gradient).max())


def test_initial_states_do_not_disturb() -> None:
    """Segments cut out of a running experiment start anywhere; the estimate does not notice."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(900)
    y = np.asarray(lfilter([0.0, 0.1, 0.05], [1.0, -1.8, 0.85], u)) + 3.0
    data = Dataset.from_arrays(
        [u[a : a + 60] for a in range(0, 900, 60)], [y[a : a + 60] for a in range(0, 900, 60)], 0.1
    )
    model = OE(na=2, nb=2, nk=1).fit(data)
    assert model.system.a[:, 0, 0] == pytest.approx([1.0, -1.8, 0.85], abs=1e-7)
    assert model.system.b[1:, 0, 0] == pytest.approx([0.1, 0.05], abs=1e-7)


def test_white_measurement_noise_is_reached_where_least_squares_is_biased() -> None:
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 1.0], 500), 8)
    truth = np.asarray(lfilter([0.0, 0.02, 0.02], [1.0, -1.9, 0.92], u))
    data = Dataset.from_arrays(u, truth + 0.2 * rng.standard_normal(len(u)), 0.02)
    fine = OE(na=2, nb=2, nk=1).fit(data)
    biased = ARX(na=2, nb=2, nk=1, refine=False).fit(data)
    floor = 0.2 * np.sqrt(5 / len(u))
    assert np.sqrt(np.mean((fine.simulate(u)[:, 0] - truth) ** 2)) < 3 * floor
    assert np.sqrt(np.mean((biased.simulate(u)[:, 0] - truth) ** 2)) > 10 * floor


def test_intervals_hold_the_truth_in_coloured_noise() -> None:
    """30 experiments; 95 % intervals from a white-noise formula would be far too narrow here."""
    inside = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.choice([-1.0, 1.0], 100), 8)
        noise = lfilter([1.0], [1.0, -0.9], 0.05 * rng.standard_normal(len(u)))
        y = np.asarray(lfilter([0.0, 0.2], [1.0, -0.8], u)) + noise
        model = OE(na=1, nb=1, nk=1).fit(Dataset.from_arrays(u, y, 0.1), Dataset.from_arrays(u, y, 0.1))
        free = list(model.free)[:2]
        inside.append(np.abs(model.flat[free] - [-0.8, 0.2]) < 1.96 * model.standard_errors[free])
    assert np.mean(inside) > 0.85


def test_predictions_use_the_colour_of_the_noise() -> None:
    rng = np.random.default_rng(2)
    u = np.repeat(rng.choice([-1.0, 1.0], 300), 8)
    innovation = 0.1 * rng.standard_normal(len(u))
    y = np.asarray(lfilter([0.0, 0.2], [1.0, -0.8], u)) + lfilter([1.0], [1.0, -0.95], innovation)
    model = OE(na=1, nb=1, nk=1).fit(Dataset.from_arrays(u, y, 0.1))
    one = model.predict(u, y[:, None], 1)[50:, 0] - y[50:]
    run = model.simulate(u, y[: model.n_init, None])[50:, 0] - y[50:]
    assert np.std(one) < 1.05 * 0.1
    assert np.std(run) > 2.0 * 0.1


def test_choices_do_not_hang_on_the_unit_of_time() -> None:
    rng = np.random.default_rng(7)
    u = np.repeat(rng.standard_normal(300), 3)
    y = np.asarray(lfilter([0.0, 0.3, 0.1], [1.0, -1.5, 0.7], u)) + 0.05 * rng.standard_normal(len(u))
    models = [OE(nk=1).fit(Dataset.from_arrays(u, y, dt)) for dt in (1.0, 0.01)]
    assert np.array_equal(models[0].flat, models[1].flat)


def test_a_higher_order_starts_from_the_lower_one() -> None:
    p, theta = problem(1, 2)
    transfer = replace(to_transfer(theta, p.orders), c=0.0)
    orders = OutputOrders(5, (4, 4), p.orders.nk)
    again = to_transfer(raise_order(transfer, orders), orders)
    u = np.random.default_rng(0).standard_normal((80, 2))
    assert again.forced(u) == pytest.approx(transfer.forced(u), abs=1e-9)


def test_burg_finds_an_autoregression_over_segments() -> None:
    rng = np.random.default_rng(3)
    pieces = [np.asarray(lfilter([1.0], [1.0, -1.2, 0.5], rng.standard_normal(2000))) for _ in range(4)]
    d, variance = noise_model(pieces)
    assert d == pytest.approx([1.0, -1.2, 0.5], abs=0.05)
    assert variance == pytest.approx(1.0, rel=0.05)
    for d, _ in burg(pieces, 8):
        assert np.abs(np.roots(d)).max(initial=0.0) < 1.0


def test_unstable_plants_and_short_segments_end_in_a_named_error() -> None:
    rng = np.random.default_rng(4)
    u = rng.standard_normal(12)
    with pytest.raises((DataError, FitError)):
        OE(na=6, nb=6, nk=1).fit(Dataset.from_arrays(u, u**2, 0.1))


@cache
def tanks() -> tuple[FloatArray, ...]:
    rows = benchmark("cascaded_tanks.csv").read_text().split()[1:]
    table = np.array([[float(x) for x in row.split(",")[:4]] for row in rows])
    return tuple(table[:, [i]] for i in range(4))


def test_cascaded_tanks() -> None:
    u, held_u, y, held_y = tanks()
    model = OE(n_init=5).fit(Dataset.from_arrays(u, y, 4.0))
    assert held_out_rmse(model, held_u, held_y, 5)[0] <= 0.595


def test_robot_arm() -> None:
    data = np.loadtxt(benchmark("robot_arm.dat"))
    model = OE().fit(Dataset.from_arrays(data[:512, 0], data[:512, 1], 0.01))
    assert held_out_rmse(model, data[512:, :1], data[512:, 1:])[0] <= 0.0105


def test_silverbox() -> None:
    """A weak nonlinearity: the linear figures, mV. Selection sees three quarters of the multisine."""
    table = np.genfromtxt(benchmark("silverbox_snls80mv.csv"), delimiter=",", skip_header=1)[:, :2]
    arrow = table[100:40575]
    multisine = table[40650:127400]
    cut = int(0.75 * len(multisine))
    model = OE().fit(Dataset.from_arrays(multisine[:cut, 0], multisine[:cut, 1], 1 / 610.35))
    parts = (multisine[cut:], arrow, arrow[:32_000])
    found = [1000 * held_out_rmse(model, p[:, :1], p[:, 1:], 50)[0] for p in parts]
    assert (np.array(found) <= [7.0, 14.5, 6.6]).all(), found


def test_an_order_that_free_runs_the_fitting_part_worse_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1, 1, 80), 10)
    y = lfilter([0.0, 0.05, 0.05], [1.0, -1.5, 0.6], u) + 0.02 * rng.standard_normal(800)
    data = Dataset.from_arrays(u, y, 0.05)
    assert len(OE(nk=1).fit(data).poles) == 2
    monkeypatch.setattr("flysid.model.linear.output_error.WORSE_FIT", 0.0)  # nothing is good enough any more
    assert len(OE(nk=1).fit(data).poles) == 1


def test_a_polynomial_shows_no_digits_that_the_data_do_not() -> None:
    text = polynomial_text(np.array([1.0, -1.50081234, 8.1e-6]), np.array([0.0, 0.003, 0.0018]))
    assert text == "1 - 1.5008 (+- 0.0059) q^-1 + 0.0000 (+- 0.0035) q^-2"
    assert polynomial_text(np.ones(40)).endswith(" + ... (28 more, to q^-39)")
    assert polynomial_text(np.array([0.0, 1e9]), np.array([0.0, 1e7])) == "1e+09 (+- 2e+07) q^-1"


def test_a_pole_that_a_zero_nearly_cancels_goes_where_the_free_run_does_not_notice() -> None:
    """A plant of order 2 got a third pole, of 14 s, whose zero was 1.6 % of its distance from one away."""
    rng = np.random.default_rng(5018)
    plant = linear_plant(rng)
    model = OE().fit(flights(plant, 4, rng, "t"))
    assert len(model.poles) == 2
    assert "a zero nearly cancels a pole" in model.notes[0]


def test_a_pole_that_a_zero_nearly_cancels_stays_where_the_free_run_shows_it() -> None:
    """Of a plant with such a pole and next to no noise."""
    rng = np.random.default_rng(5)
    u = rng.normal(size=3000).cumsum() / 20.0
    y = lfilter([0.0, 0.1, -0.1 * 0.9905], np.convolve([1.0, -0.9], [1.0, -0.99]), u)
    model = OE(nk=1).fit(Dataset.from_arrays([u], [y + 1e-4 * rng.normal(size=3000)], 0.01))
    assert np.abs(model.poles - 0.99).min() < 1e-3


def test_every_output_is_reduced_by_itself() -> None:
    rng = np.random.default_rng(5018)
    spare = flights(linear_plant(rng), 4, rng, "t")
    u = np.concatenate([s.u for s in spare.segments])
    other = lfilter([0.0, 0.1, 0.05], np.convolve([1.0, -0.8], [1.0, -0.6, 0.25]), u[:, 0])
    inputs = [part.u for part in spare.segments]
    outputs = [
        np.column_stack([part.y, own]) for part, own in zip(spare.segments, np.split(other, 4), strict=True)
    ]
    model = OE(nk=1).fit(Dataset.from_arrays(inputs, outputs, spare.dt_s))
    a = model.system.a[:, [0, 1], [0, 1]]
    assert a[3, 0] == 0.0
    assert a[3, 1] != 0.0
