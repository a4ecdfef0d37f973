"""How nonlinear an output is, on plants whose nature is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.verdict_fairness import Plant, flights, linear_plant, nonlinear_plant
from flysid.dataset import Dataset, Segment
from flysid.model.arx import ARX
from flysid.model.nonlinearity import nonlinearity
from flysid.model.oe import OE

SEEDS = range(6)


def flown(plant: Plant, seed: int, count: int = 4) -> Dataset:
    return flights(plant, count, np.random.default_rng([seed, 31]), "f")


@pytest.fixture(scope="module")
def drag() -> Dataset:
    return flown(Plant("drag", _drag, 0.05, 0.0), 0)


def _drag(u: np.ndarray) -> np.ndarray:
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = 0.95 * y[k - 1] - 0.03 * abs(y[k - 1]) * y[k - 1] + 0.1 * u[k - 1]
    return y


def test_linear_plants_are_called_linear_and_others_are_not() -> None:
    linear = [flown(linear_plant(np.random.default_rng([s, 32])), s) for s in SEEDS]
    bent = [flown(nonlinear_plant(np.random.default_rng([s, 33])), s) for s in SEEDS]
    found = [[nonlinearity(OE().fit(data), data)[0].found for data in group] for group in (linear, bent)]
    assert sum(found[0]) <= 1
    assert sum(found[1]) >= len(SEEDS) - 1


def test_the_share_is_a_lower_bound_and_not_far_below(drag: Dataset) -> None:
    model = OE().fit(drag)
    clean = [(s, _drag(s.u[:, 0])) for s in drag.segments]
    left = [(model.simulate(s.u, s.y[: model.n_init])[:, 0] - y)[20:] for s, y in clean]
    true = np.concatenate(left).std() / np.concatenate([y for _, y in clean]).std()
    answer = nonlinearity(model, drag)[0]
    assert answer.found
    assert true / 2.0 < answer.share < 1.05 * true
    assert answer.words.startswith(f"At least {100 * answer.share:.2g} % of y (of its standard deviation)")


def test_units_and_offsets_change_nothing(drag: Dataset) -> None:
    scaled = tuple(Segment(1e-3 * s.u + 5.0, 40.0 * s.y - 300.0, flight=s.flight) for s in drag.segments)
    other = replace(drag, segments=scaled)
    shares = [nonlinearity(ARX(2, 2, 1, refine=False).fit(d), d)[0].share for d in (drag, other)]
    assert shares[1] == pytest.approx(shares[0], rel=1e-3)


def test_of_what_is_not_found_the_share_that_would_have_shown_is_said() -> None:
    data = flown(linear_plant(np.random.default_rng(5)), 5)
    answer = nonlinearity(OE().fit(data), data)[0]
    assert not answer.found
    assert 0.0 < answer.smallest < 0.3
    assert "would have been detected" in answer.words


def test_few_samples_say_nothing(drag: Dataset) -> None:
    short = replace(drag, segments=(replace(drag.segments[0], u=drag.segments[0].u[:150],
                                            y=drag.segments[0].y[:150]),))  # fmt: skip
    answer = nonlinearity(ARX(2, 2, 1, refine=False).fit(short), short)[0]
    assert (answer.found, answer.share, answer.words) == (False, 0.0, "")


def test_every_output_and_input_has_its_turn(drag: Dataset) -> None:
    rng = np.random.default_rng(1)
    segments = []
    for s in drag.segments:
        other = rng.standard_normal(len(s))
        lagged = np.convolve(other, np.full(5, 0.2))[: len(s)] + 0.05 * rng.standard_normal(len(s))
        segments.append(Segment(np.column_stack([s.u, other]), np.column_stack([s.y, lagged])))
    two = Dataset.from_arrays([s.u for s in segments], [s.y for s in segments], drag.dt_s)
    bent, straight = nonlinearity(ARX(2, 5, 1, refine=False).fit(two), two)
    assert bent.found
    assert not straight.found
