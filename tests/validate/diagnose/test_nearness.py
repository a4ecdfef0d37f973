"""Holes inside the training range: an input of three levels, and one of all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.model.arx import ARX
from flysid.model.line import Line
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.cautions import cautions
from flysid.validate.diagnose.diagnostics import diagnose
from flysid.validate.diagnose.document import to_json
from flysid.validate.diagnose.nearness import UNUSUAL, nearness

DT = 0.02


def flights(seed: int, levels: Sequence[float] = (), count: int = 2, rows: int = 1500) -> Dataset:
    rng = np.random.default_rng(seed)
    us: list[FloatArray] = []
    ys: list[FloatArray] = []
    for _ in range(count):
        held = rng.choice(levels, rows // 25) if levels else rng.uniform(-1.0, 1.0, rows // 25)
        us.append(np.repeat(held, 25)[:, None])
        ys.append(lfilter([0.0, 0.1], [1.0, -0.9], us[-1], axis=0) + 0.01 * rng.normal(size=(rows, 1)))
    return Dataset.from_arrays(us, ys, DT)


THREE = (-1.0, 0.0, 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_continuous_input_falls_into_the_holes_of_three_levels(seed: int) -> None:
    found = nearness(flights(seed, THREE), flights(seed + 10), 5)
    assert found is not None
    assert found.far > 0.9
    assert found.typical > found.usual


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("levels", [(), THREE])
def test_flights_of_one_kind_fill_what_training_left(seed: int, levels: Sequence[float]) -> None:
    found = nearness(flights(seed, levels), flights(seed + 10, levels), 5)
    assert found is not None
    assert found.far < UNUSUAL


def test_what_leaves_the_range_is_no_hole() -> None:
    train = flights(0)
    test = flights(1)
    beyond = Dataset.from_arrays([3.0 + s.u for s in test.segments], [30.0 + s.y for s in test.segments], DT)
    found = nearness(train, beyond, 5)
    assert found is not None
    assert found.far == 0.0


def test_too_little_or_nothing_moving_is_not_judged() -> None:
    still = Dataset.from_arrays(np.zeros(100), np.zeros(100), DT)
    assert nearness(still, still, 1) is None
    short = flights(0, count=1, rows=50)
    assert nearness(short, short, 60) is None


def test_distances_are_those_of_the_definition() -> None:
    """Recomputed sample by sample: blocks of ten, points of now and of `LAG` samples ago, in spreads."""
    rng = np.random.default_rng(4)
    lag = 3

    def flight(rows: int, level: float, noise: float) -> tuple[FloatArray, FloatArray]:
        u = rng.choice([-level, level], rows) + noise * rng.normal(size=rows)
        return np.column_stack([u, np.ones(rows)]), u[:, None] + noise * rng.normal(size=(rows, 1))

    train = [flight(rows + lag, 1.0, 0.05) for rows in (60, 40)]
    test = [flight(30, 1.0, 0.2), flight(lag - 1, 1.0, 0.05), flight(80, 0.0, 0.5)]

    def dataset(of: Sequence[tuple[FloatArray, FloatArray]]) -> Dataset:
        return Dataset.from_arrays([u for u, _ in of], [y for _, y in of], DT)

    found = nearness(dataset(train), dataset(test), lag)
    moving = [np.column_stack([u[:, 0], y[:, 0]]) for u, y in train + test]
    spread = np.vstack(moving[:2]).std(axis=0)
    points = [[(*(x[k] / spread), *(x[k - lag] / spread)) for k in range(lag, len(x))] for x in moving]
    blocks = [points[0][k : k + 10] for k in range(0, 60, 10)] + [
        points[1][k : k + 10] for k in range(0, 40, 10)
    ]
    own = [
        min(np.linalg.norm(np.subtract(p, q)) for other in blocks if other is not b for q in other)
        for b in blocks
        for p in b
    ]
    every = points[0] + points[1]
    low, high = np.min(every, axis=0), np.max(every, axis=0)
    usual = np.quantile(own, 0.99)
    near = [[min(np.linalg.norm(np.subtract(p, q)) for q in every) for p in of] for of in points[2:]]
    far = [
        [d > usual and bool(((low <= p) & (p <= high)).all()) for d, p in zip(*of, strict=True)]
        for of in zip(near, points[2:], strict=True)
    ]
    assert found is not None
    assert found.usual == pytest.approx(usual)
    assert found.typical == pytest.approx(np.median(near[0] + near[2]))
    assert found.far == pytest.approx(np.mean(far[0] + far[2]))
    assert found.worst_segment == 2
    assert found.worst_far == pytest.approx(np.mean(far[2]))
    assert 0.0 < found.far < found.worst_far < 1.0


def test_the_page_and_the_document_say_so() -> None:
    train = flights(0, THREE)
    compared = {"c": compare([ARX(1, 1, 1).fit(train), Line().fit(train)], flights(3))}
    diagnoses = {"c": diagnose(compared["c"], train)}
    (said,) = [c for c in cautions(compared, diagnoses) if "holes of the training data" in c.text]
    assert said.level == "warning"
    document = to_json(compared, diagnoses)
    assert document["diagnostics"]["c"]["distance_to_training"]["far"] > 0.9
