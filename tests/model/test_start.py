"""The start of a free run: estimated from a window, not read off noisy lags."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.model.freerun import Difference
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.start import estimate_start, start_window
from tests.model_examples import data, fitted

DT = 0.01


@dataclass
class Oscillator:
    """y(k) = 2 r cos(w) y(k-1) - r^2 y(k-2) + b u(k-1); only what `estimate_start` needs of a model."""

    radius: float = 0.995
    angle: float = 0.045
    n_init: int = 2

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        y = np.zeros((len(u), 1))
        y[:2] = 0.0 if y0 is None else y0
        for k in range(2, len(u)):
            y[k] = (
                2 * self.radius * np.cos(self.angle) * y[k - 1] - self.radius**2 * y[k - 2] + 0.002 * u[k - 1]
            )
        return y


@pytest.fixture(scope="module")
def noisy() -> tuple[Oscillator, FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(3)
    model = Oscillator()
    u = np.sin(np.arange(1000) * 0.02)[:, None]
    truth = model.simulate(u, np.array([[0.3], [0.31]]))
    return model, u, truth, truth + 0.02 * rng.standard_normal(truth.shape)


def test_without_noise_the_true_lags_come_back(
    noisy: tuple[Oscillator, FloatArray, FloatArray, FloatArray],
) -> None:
    model, u, truth, _ = noisy
    np.testing.assert_allclose(estimate_start(model, u[:100], truth[:100]), truth[:2], atol=1e-9)


def test_with_noise_the_free_run_starts_far_closer_than_from_measured_lags(
    noisy: tuple[Oscillator, FloatArray, FloatArray, FloatArray],
) -> None:
    model, u, truth, y = noisy
    start = estimate_start(model, u[:100], y[:100])
    estimated = np.sqrt(np.mean((model.simulate(u, start)[100:] - truth[100:]) ** 2))
    measured = np.sqrt(np.mean((model.simulate(u, y[:2])[100:] - truth[100:]) ** 2))
    assert estimated < 0.01
    assert measured > 5 * estimated


def test_a_linear_model_is_asked_for_one_jacobian_only(
    noisy: tuple[Oscillator, FloatArray, FloatArray, FloatArray],
) -> None:
    model, u, _, y = noisy
    calls: list[int] = []

    class Counted(Oscillator):
        def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
            calls.append(1)
            return super().simulate(u, y0)

    found = estimate_start(Counted(), u[:100], y[:100])
    np.testing.assert_allclose(found, estimate_start(model, u[:100], y[:100]))
    guesses = 3
    assert len(calls) == guesses + 2 * model.n_init + 1


def test_a_window_with_no_more_equations_than_unknowns_gives_the_measured_lags() -> None:
    y = np.array([[1.0], [2.0], [3.0]])
    np.testing.assert_array_equal(estimate_start(Oscillator(), np.zeros((3, 1)), y), y[:2])


@pytest.mark.parametrize(
    ("n_init", "n", "dt", "expected"),
    [(4, 10_000, 0.01, 100), (4, 10_000, 1.0, 20), (4, 100, 1.0, 10), (4, 20, 1.0, 4), (0, 10_000, 0.02, 50)],
)
def test_window(n_init: int, n: int, dt: float, expected: int) -> None:
    assert start_window(n_init, n, dt) == expected


def test_every_structure_runs_freely_as_the_comparison_starts_it() -> None:
    """From the window, not from the first noisy samples; the function that scores is the same one."""
    from flysid.dataset import Dataset
    from flysid.model.arx import ARX
    from flysid.validate.compare.trials import free_run

    rng = np.random.default_rng(5)
    u = np.repeat(rng.normal(size=60), 20)[:, None]
    truth = Oscillator(radius=0.98).simulate(u, np.zeros((2, 1)))
    data = Dataset.from_arrays(u, truth + 0.02 * np.std(truth) * rng.standard_normal(truth.shape), DT)
    model = ARX(na=4, nb=4, nk=1, refine=False).fit(data)
    (segment,) = data.segments
    window = start_window(model.n_init, len(segment), DT)
    np.testing.assert_array_equal(model.free_run(segment)[window:], free_run(model, segment, window))
    assert model.free_run(segment).shape == segment.y.shape


@pytest.mark.parametrize("name", ["arx", "oe", "fir"])
@pytest.mark.parametrize("knows_its_state", [True, False])
def test_what_a_linear_model_says_of_its_start_is_what_its_runs_do(name: str, knows_its_state: bool) -> None:
    model = fitted(name)
    assert isinstance(model, FittedLinear)
    model = (model if knows_its_state else replace(model, starts=None)).unlimited()
    u = data().segments[0].u[:40]
    start = data().segments[0].y[: model.n_init]
    still = model.simulate(u, start)
    for i in range(model.n_init):
        moved = start.copy()
        moved[i] += 1.0
        difference = model.simulate(u, moved) - still
        np.testing.assert_allclose(model.start_responses(40)[:, :, i, 0], difference, atol=1e-12)


def test_of_an_impulse_response_no_start_is_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """None of its outputs comes back; with 120 taps this was most of a fit's time."""
    model = fitted("fir")
    assert isinstance(model, FittedLinear)
    monkeypatch.delattr(Difference, "respond")
    found = model.start_responses(model.n_init + 10)[:, 0, :, 0]
    assert np.array_equal(found, np.eye(model.n_init + 10, model.n_init))
