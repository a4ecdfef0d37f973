"""Triangles of flights in any tree are those of all flights, and give the model of a fit in memory."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.dataset import FloatArray, Segment
from flysid.errors import DataError
from flysid.fleet.models.common_grid import Sampling
from flysid.fleet.models.groups import fit_group, response_of
from flysid.fleet.models.scatter import tail_of
from flysid.fleet.models.triangles import triangle_of
from flysid.model.gram import tsqr

SAMPLING = Sampling(0.1, 4, 32, ("u",), ("y",), ("deg", "m/s"))
N = SAMPLING.regressors


def flight(
    seed: int, samples: int = 300, gain: float = 0.5, noise: float = 0.05, trim: float = 0.0
) -> Segment:
    """y(k) = 0.8 y(k-1) + gain u(k-1) + noise, on a trim that differs from flight to flight."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(samples // 10 + 1), 10)[:samples]
    y = np.zeros(samples)
    for k in range(1, samples):
        y[k] = 0.8 * y[k - 1] + gain * u[k - 1] + noise * rng.standard_normal()
    return Segment(u[:, None], y[:, None] + trim, flight=f"flight-{seed}")


def in_memory(segments: list[Segment]) -> FloatArray:
    """Least squares of all rows, each flight less its means."""
    phis, ys = [], []
    for s in segments:
        k = np.arange(SAMPLING.lags, len(s))
        u = [s.u[k - lag, 0] for lag in range(SAMPLING.lags + 1)]
        y = [s.y[k - lag, 0] for lag in range(1, SAMPLING.lags + 1)]
        phi = np.column_stack([*u, *y])
        phis.append(phi - phi.mean(axis=0))
        ys.append(s.y[k, 0] - s.y[k, 0].mean())
    return np.asarray(np.linalg.lstsq(np.vstack(phis), np.concatenate(ys), rcond=None)[0])


def merged(triangles: list[FloatArray], cuts: list[int]) -> FloatArray:
    """The triangle of a tree: neighbours are put together where the cuts say, until one is left."""
    left = list(triangles)
    turn = 0
    while len(left) > 1:
        at = cuts[turn % len(cuts)] % (len(left) - 1) if cuts else 0
        left[at : at + 2] = [tsqr(left[at : at + 2], left[at].shape[1])]
        turn += 1
    return left[0]


@settings(max_examples=40, deadline=None)
@given(
    st.permutations(range(7)), st.lists(st.integers(0, 100), min_size=1, max_size=7), st.floats(-50.0, 50.0)
)
def test_any_tree_and_any_order_give_the_fit_in_memory(
    order: list[int], cuts: list[int], trim: float
) -> None:
    segments = [flight(seed, 60 + 40 * seed, trim=trim * seed) for seed in order]
    made = [triangle_of([s], SAMPLING) for s in segments]
    rows = sum(t.rows for t in made)
    centred = merged([t.r[1:, 1:] for t in made], cuts)
    whole = np.zeros((SAMPLING.columns,) * 2)
    whole[1:, 1:] = centred
    expected = in_memory(segments)
    for found in (fit_group([whole], rows, SAMPLING), fit_group([t.r for t in made], rows, SAMPLING)):
        np.testing.assert_allclose(found.theta, expected, rtol=0.0, atol=1e-10 * np.abs(expected).max())


def test_the_same_order_gives_the_same_bytes() -> None:
    def once() -> bytes:
        made = [triangle_of([flight(s)], SAMPLING) for s in range(5)]
        group = fit_group([t.r for t in made], sum(t.rows for t in made), SAMPLING)
        return b"".join(t.r.tobytes() for t in made) + group.theta.tobytes()

    assert once() == once()


def test_trim_of_a_flight_moves_nothing() -> None:
    still = [triangle_of([flight(s)], SAMPLING) for s in range(4)]
    moved = [triangle_of([flight(s, trim=30.0 * s)], SAMPLING) for s in range(4)]
    one, other = (fit_group([t.r for t in made], 1184, SAMPLING) for made in (still, moved))
    np.testing.assert_allclose(one.theta, other.theta, atol=1e-10)
    with_one_constant = tsqr([t.r for t in moved], SAMPLING.columns)
    common = fit_group([with_one_constant], 1184, SAMPLING)
    assert np.abs(common.theta - one.theta).max() > 0.01


def test_covariance_is_that_of_flights_and_not_of_samples() -> None:
    """Flights whose gain differs: the scatter between them is seen, white residuals would not see it."""
    rng = np.random.default_rng(3)

    def group(first: int) -> tuple[float, float]:
        made = [
            triangle_of([flight(first + i, gain=0.5 * (1.0 + 0.1 * rng.standard_normal()))], SAMPLING)
            for i in range(6)
        ]
        model = fit_group([t.r for t in made], sum(t.rows for t in made), SAMPLING)
        response = response_of(model, SAMPLING, np.array([0.5]))
        return response.value[0], float(np.sum(response.influences[:, 0] ** 2))

    found = [group(100 * i) for i in range(1, 60)]
    true = float(np.var([value for value, _ in found]))
    assert 0.6 < np.mean([variance for _, variance in found]) / true < 2.5


def test_a_flight_that_tells_nearly_all_does_not_hide_its_scatter() -> None:
    """Of two flights one is ten times as long: its plain scores would be far too small."""
    sampling = Sampling(0.1, 1, 32, ("u",), ("y",), ("deg", "m/s"))
    values, variances = [], []
    for seed in range(150):
        made = [triangle_of([s], sampling) for s in (flight(seed, 400), flight(1000 + seed, 40))]
        model = fit_group([t.r for t in made], sum(t.rows for t in made), sampling)
        response = response_of(model, sampling, np.array([1.0]))
        values.append(response.value[0])
        variances.append(float(np.sum(response.influences[:, 0] ** 2)))
    assert 0.5 < np.mean(variances) / np.var(values) < 2.0


def test_too_little_is_refused() -> None:
    with pytest.raises(DataError, match="do not determine"):
        fit_group([triangle_of([flight(1, 12)], SAMPLING).r], 8, SAMPLING)
    still = Segment(np.ones((100, 1)), np.ones((100, 1)), flight="still")
    with pytest.raises(DataError, match="do not determine"):
        fit_group([triangle_of([still], SAMPLING).r], 96, SAMPLING)


def test_a_fleet_that_strays_further_is_believed_less() -> None:
    rng = np.random.default_rng(1)
    even = rng.chisquare(6, 100)
    uneven = even / rng.chisquare(4, 100) * 4.0
    assert tail_of(even.tolist(), 6, 200).p_value(30.0, 6) < 1e-3
    assert tail_of(uneven.tolist(), 6, 200).p_value(30.0, 6) > 5e-3
    assert tail_of(uneven[:18].tolist(), 6, 200) == tail_of([], 6, 200)  # too few to tell: Hotelling's
    assert tail_of((0.1 * even).tolist(), 6, 200).scale >= tail_of([], 6, 200).scale  # never believed more
