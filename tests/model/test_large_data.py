"""Sizes that no other test has, the cheap ones; the rest is row 16 of the soak."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.model.arx import ARX
from flysid.model.base import Estimator
from flysid.model.oe import OE
from tests.large_trials import Size, defaults, fits_of_sizes, sizes, structures


@pytest.mark.parametrize("estimator", [ARX(na=4, nb=4, nk=1), OE(na=2, nb=2, nk=1, n_init=2500)])
def test_a_start_may_be_estimated_from_more_rows_than_any_fixed_number(estimator: Estimator) -> None:
    data = Size(100_000).data()
    model = estimator.fit(data)
    s = data.segments[0]
    miss = (model.simulate(s.u, s.y[: model.n_init]) - s.y)[model.n_init :]
    assert np.std(miss) < 0.06 * np.std(s.y)


@pytest.mark.parametrize("label", structures() | defaults())
def test_one_sample_and_ten_are_named_or_fitted(label: str) -> None:
    """With one thing unusual at a time; the soak has all that they combine to."""
    estimator = (structures() | defaults())[label]
    outcome = fits_of_sizes(label, estimator, [s for s in sizes() if s.samples <= 10 and s.unusual <= 1])
    assert outcome.failures == []
    assert outcome.raised > 0 or label in ("mean", "persistence", "line")
