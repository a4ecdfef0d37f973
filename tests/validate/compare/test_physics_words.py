"""Is a physical model enough? The comparison says so where one is among the models."""

from __future__ import annotations

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.mean import Mean
from flysid.model.multirotor import Multirotor
from flysid.model.rotorcraft.rotor_axis import NAMES, free_run
from flysid.validate.compare.words import physics_words
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.context import ReportContext
from flysid.validate.show.page.page import render


def rates(seed: int, flights: int = 6, curve: float = 1.0) -> Dataset:
    """A roll rate behind two motors with a lag of 0.1 s, a square thrust curve and drag."""
    rng = np.random.default_rng(seed)
    theta = np.zeros(len(NAMES) + 2)
    theta[:4] = 0.1, 0.02, curve, 2.0
    theta[-2:] = 30.0, -30.0
    segments = []
    for flight in range(flights):
        u: FloatArray = np.repeat(rng.uniform(0.1, 1.0, (40, 2)), 10, axis=0)
        y = free_run(u, 0.0, theta, 0.02, True, False) + 0.05 * rng.standard_normal(len(u))
        segments.append(Segment(u, y[:, None], flight=f"{flight}"))
    signals = (Signal("left"), Signal("right"))
    return Dataset(0.02, signals, (Signal("p", "rad/s"),), tuple(segments), "roll")


def test_the_comparison_says_that_physics_is_enough_where_it_is() -> None:
    train = rates(1)
    models: dict[str, Fitted] = {
        "arx": ARX(na=2, nb=2, nk=1).fit(train),
        "multirotor": Multirotor().fit(train),
    }
    compared = compare(models, rates(2), train=train)
    (said,) = physics_words(compared)
    assert said.startswith("p: a physical model is enough (MULTIROTOR better")
    assert said.endswith("against ARX).")
    page = render(ReportContext({"roll": compared}, train={"roll": train}))
    assert '<p class="small">A physical model is enough (MULTIROTOR better' in page


def test_and_that_it_is_not_where_it_is_not() -> None:
    train = rates(1, curve=0.0)
    models: dict[str, Fitted] = {
        "arx": ARX(na=2, nb=2, nk=1).fit(train),
        "multirotor": Multirotor(kind="acceleration").fit(train),
    }
    (said,) = physics_words(compare(models, rates(2, curve=0.0), train=train))
    assert "a physical model is not enough (MULTIROTOR worse" in said


def test_it_says_nothing_where_none_was_compared() -> None:
    train = rates(1)
    models: dict[str, Fitted] = {"arx": ARX(na=2, nb=2, nk=1).fit(train), "mean": Mean().fit(train)}
    assert physics_words(compare(models, rates(2), train=train)) == []
