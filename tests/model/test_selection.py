"""Candidates are judged by the free run that `compare` starts."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray
from flysid.model import arx, iv, selection, statespace, transfer_function
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.model.iv import IV
from flysid.model.linear import output_error
from flysid.model.oe import OE
from flysid.model.start import run_from_window
from flysid.model.statespace import StateSpace
from flysid.model.subspace import order_search
from flysid.model.transfer_function import TF
from tests.model.linear.test_transfer import experiment

JUDGES = (arx, iv, statespace, transfer_function, output_error, order_search)


@pytest.mark.parametrize("estimator", [ARX(), OE(), TF(), StateSpace(), IV()], ids=lambda e: type(e).__name__)
def test_a_candidate_is_judged_from_an_estimated_start(
    estimator: Estimator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Started from its first measured lags alone a model can err three times as much."""
    judged: list[tuple[FloatArray, FloatArray]] = []

    def compared(model: Fitted, data: Dataset, skip: int, scale: FloatArray) -> FloatArray:
        found = selection.block_errors(model, data, skip, scale)
        if getattr(model, "is_stable", True) is False:  # is ranked behind all others
            return found
        assert model.n_init == skip
        runs = [
            np.mean(((run_from_window(model, s, skip) - s.y)[skip:] / scale) ** 2, axis=1)
            for s in data.segments
            if len(s) > skip
        ]
        judged.append((found, selection.block_means(runs)))
        return found

    for module in JUDGES:
        monkeypatch.setattr(module, "block_errors", compared)
    estimator.fit(experiment("lateral", 0.05, 0.05))
    assert judged
    for found, right in judged:
        np.testing.assert_allclose(found, right, rtol=1e-3)


def test_a_held_out_block_begins_with_its_guard() -> None:
    """Which serves neither part: what starts a run costs the block few rows, and was not fitted to."""
    train = experiment("lateral", 0.05, 0.05)
    step_ns = round(train.dt_s * 1e9)

    def rows(data: Dataset) -> set[int]:
        return {s.t0_ns // step_ns + k for s in data.segments for k in range(len(s))}

    fit, check = selection.parts_to_choose_on(train)
    split = train.plan_split(holdout=selection.HELD_OUT)
    plain_fit, held = split.apply(train)
    lead = rows(check) - rows(held)
    assert rows(fit) == rows(plain_fit)
    assert not rows(fit) & rows(check)
    assert 0 < len(lead) <= len(held.segments) * round(split.guard_s / train.dt_s)
