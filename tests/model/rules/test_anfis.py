"""ANFIS: the gradient is the gradient, learning lowers the error, and the free run is another matter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bench.ts_intervals import experiment, known_model
from flysid.dataset import Dataset
from flysid.errors import DataError, UsageError
from flysid.model.anfis import ANFIS, _Learner

SETTINGS = ANFIS(rules=2, na=1, nb=1, nk=1, antecedents=("u(k-1)",))


@pytest.fixture(scope="module")
def data() -> Dataset:
    return experiment(known_model(), 1)


def test_the_gradient_is_that_of_the_error(data: Dataset) -> None:
    learner = _Learner.of(SETTINGS._layout(data), data, 2)
    body = learner.with_consequents(learner.start)
    by_centre, by_width = learner.slopes(body)
    n = len(learner.Y)
    for r in range(2):
        step = np.zeros((2, 1))
        step[r] = 1e-5
        up, down = (replace(body, centre=body.centre + s) for s in (step, -step))
        wider, narrower = (replace(body, width=body.width * np.exp(s)) for s in (step, -step))
        for slope, one, other in ((by_centre, up, down), (by_width, wider, narrower)):
            difference = learner.error(one) - learner.error(other)
            assert slope[r, 0] == pytest.approx(n * difference / 4e-5, rel=1e-4, abs=1e-6)


def test_learning_lowers_the_error(data: Dataset) -> None:
    learner = _Learner.of(SETTINGS._layout(data), data, 2)
    errors = [learner.error(body) for body in learner.epochs(40, 0.02)]
    assert min(errors) < 0.97 * errors[0]


def test_without_noise_it_finds_the_rules() -> None:
    truth = known_model()
    u = experiment(truth, 1).segments[0].u
    y = truth.simulate(u, np.zeros((truth.n_init, 1)))
    model = replace(SETTINGS, epochs=300).fit(Dataset.from_arrays(u, y, truth.dt_s))
    run = model.simulate(u, y[: model.n_init])
    assert float(np.sqrt(np.mean((run - y) ** 2))) < 0.01 * float(y.std())
    assert "ANFIS" in str(model)


def test_the_best_epoch_is_chosen_on_validation_data(data: Dataset) -> None:
    validation = experiment(known_model(), 2)
    model = SETTINGS.fit(data, validation)
    assert np.isfinite(model.simulate(validation.segments[0].u)).all()


@pytest.mark.parametrize(
    ("given", "word"),
    [({"rules": 0}, "rules is at least 1"), ({"step": 2.0}, "step=2"), ({"nb": 0}, "nb is at least 1")],
)
def test_settings_that_cannot_be(given: dict[str, Any], word: str) -> None:
    with pytest.raises(UsageError, match=word):
        ANFIS(**given)


def test_too_few_samples_are_refused(data: Dataset) -> None:
    with pytest.raises(DataError, match="too few samples"):
        ANFIS(rules=5).fit(Dataset.from_arrays(data.segments[0].u[:20], data.segments[0].y[:20], 0.05))
