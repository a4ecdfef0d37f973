"""Bands of frequency response and free run: against the models' own, and against truth."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.model.arx import ARX
from flysid.model.start import estimate_start
from flysid.model.statespace import StateSpace
from flysid.model.ts import TS, over_lags
from flysid.validate.compare.trials import free_run
from flysid.validate.compare_models import compare
from flysid.validate.diagnose.bands import curves, free_run_band
from flysid.validate.diagnose.checks import intervals
from flysid.validate.diagnose.diagnostics import diagnose
from flysid.validate.diagnose.document import to_json
from flysid.validate.diagnose.responses import responses
from flysid.validate.show.page import ReportContext, render
from tests.fakes import FirstOrder, flown

TRUTH = FirstOrder(a=0.9, b=0.1)
TRAIN = flown(TRUTH, [400] * 3, noise=0.05)
HZ = np.geomspace(0.05, 9.0, 12)


@pytest.mark.parametrize("which", [0, 1], ids=["arx", "state space"])
def test_bands_of_linear_models_hold_the_truth(which: int) -> None:
    model = (ARX(na=1, nb=1, nk=1), StateSpace(order=1, refine=True))[which].fit(TRAIN)
    (curve,) = curves(model, HZ, (0, 0))
    (truth,) = responses(TRUTH, HZ, 0, 0)
    assert curve.band is not None
    assert (curve.band.low < np.abs(curve.response)).all()
    assert (np.abs(curve.response) < curve.band.high).all()
    inside = (curve.band.low < np.abs(truth)) & (np.abs(truth) < curve.band.high)
    assert inside.mean() > 0.8
    known = intervals(model, TRAIN)
    assert known is not None
    low, high = known.gain[:, 0, 0, 0]
    assert low < 1.0 < high  # the truth: 0.1 / (1 - 0.9)
    assert high - low < 0.3
    segment = flown(TRUTH, [300], noise=0.0, seed=9).segments[0]
    band = free_run_band(model, segment, 20)
    assert band is not None
    assert band[0].shape == (280, 1)
    assert (band[0] <= band[1]).all()
    held = (band[0] <= segment.y[20:]) & (segment.y[20:] <= band[1])
    assert held.mean() > 0.8


def test_the_band_of_arx_is_the_models_own() -> None:
    model = ARX(na=1, nb=1, nk=1).fit(TRAIN)
    segment = TRAIN.segments[0]
    low, high = model.simulation_band(
        segment.u, estimate_start(model, segment.u[:20], segment.y[:20]), draws=100
    )
    band = free_run_band(model, segment, 20)
    assert band is not None
    np.testing.assert_array_equal(band[0], low[20:])
    np.testing.assert_array_equal(band[1], high[20:])


def test_rules_have_a_band_each() -> None:
    data: Dataset = flown(FirstOrder(a=0.9, b=0.1, d=-0.3), [300] * 3, noise=0.02)
    model = over_lags(TS(rules=2, na=1, nb=1, nk=1), data)
    known = intervals(model, data)
    assert known is not None
    found = curves(model, HZ, (0, 0), known.fuzzy)
    assert len(found) == 2
    for curve in found:
        assert curve.band is not None
        assert (curve.band.low <= curve.band.high).all()
        assert (curve.band.turn_low <= curve.band.turn_high).all()
    segment = data.segments[0]
    band = free_run_band(model, segment, 10, known.fuzzy)
    assert band is not None
    run = free_run(model, segment, 10)
    np.testing.assert_allclose(band[1] - run, run - band[0], rtol=1e-3)  # to first order
    assert 0.0 < float(np.mean(band[1] - band[0])) < 0.1 * float(np.std(segment.y))


def test_a_model_that_does_not_know_has_none() -> None:
    (curve,) = curves(TRUTH, HZ, (0, 0))
    assert curve.band is None
    assert free_run_band(TRUTH, TRAIN.segments[0], 10) is None


def test_fewer_words_have_a_price_on_the_page_and_in_the_document() -> None:
    """Three rules for a plant that two describe: merging two of them costs next to nothing, and is said."""
    data = flown(FirstOrder(a=0.9, b=0.1, d=-0.3), [300] * 4, noise=0.02)
    spare = over_lags(TS(rules=3, na=1, nb=1, nk=1), data)
    arx = ARX(na=1, nb=1, nk=1).fit(data)
    c = compare(
        [arx, spare], flown(FirstOrder(a=0.9, b=0.1, d=-0.3), [300] * 6, noise=0.02, seed=4), train=data
    )
    found = diagnose(c, data)
    cheapest = found.checks["ts"].simpler[0]
    assert "merged" in cheapest.what or "dropped" in cheapest.what
    assert cheapest.loss_pct < 5.0
    assert not found.checks["arx"].simpler
    assert str(cheapest) in render(ReportContext({"roll": c}, train={"roll": data}))
    document = to_json({"roll": c}, {"roll": found})
    assert document["diagnostics"]["roll"]["checks"]["ts"]["simpler"][0]["what"] == cheapest.what
