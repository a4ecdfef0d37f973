"""Candidates are judged by the free run that `compare` starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import DataError
from flysid.leakage.copies import Copy, find_copy
from flysid.model import arx, iv, selection, statespace, transfer_function
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted
from flysid.model.iv import IV
from flysid.model.last_gates import HeldValue
from flysid.model.linear import output_error
from flysid.model.oe import OE
from flysid.model.shared import sharing
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


def flown(flights: int, samples: int = 300) -> Dataset:
    rng = np.random.default_rng(flights)
    return Dataset.from_arrays(
        [rng.standard_normal(samples) for _ in range(flights)],
        [rng.standard_normal(samples) for _ in range(flights)],
        0.05,
    )


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The sample time of every search for copies."""
    found: list[float] = []

    def counted(train: Sequence[Segment], test: Sequence[Segment], dt_s: float) -> Copy | None:
        found.append(dt_s)
        return find_copy(train, test, dt_s)

    monkeypatch.setattr("flysid.split.find_copy", counted)
    return found


@pytest.mark.parametrize(("flights", "splits"), [(4, 1), (2, 2)])
def test_equal_data_are_split_once(flights: int, splits: int, searches: list[float]) -> None:
    """A guard counts only where blocks of time are held out."""
    train = flown(flights)
    again = flown(flights)
    with sharing():
        parts = selection.parts_to_choose_on(train)
        assert selection.parts_to_choose_on(again) is parts
        selection.parts_to_choose_on(again, guard_s=0.2)
        selection.parts_to_choose_on(train, guard_s=0.2)
    assert len(searches) == splits
    selection.parts_to_choose_on(train)
    assert len(searches) == splits + 1


def test_what_differs_is_split_anew(searches: list[float]) -> None:
    """What a fit remembers holds for these flights at this rate alone."""
    train = flown(4)
    first, *others = train.segments
    changed = [
        train.with_segments(others),
        train.with_segments([replace(first, t0_ns=10**9), *others]),
        train.with_segments([replace(first, flight="other"), *others]),
        train.with_segments([replace(first, marks={"mode": "LOITER"}), *others]),
        replace(train, dt_s=0.1),
        replace(train, name="pitch"),
    ]
    with sharing():
        selection.parts_to_choose_on(train)
        for data in changed:
            parts = selection.parts_to_choose_on(data)
            assert {part.name for part in parts} == {data.name}
            assert {part.dt_s for part in parts} == {data.dt_s}
            whole = {(s.flight, s.t0_ns, *s.marks) for s in data.segments}
            assert {(s.flight, s.t0_ns, *s.marks) for s in chain(*(part.segments for part in parts))} == whole
        selection.parts_to_choose_on(train, seed=1)
        assert len(searches) == 1 + len(changed) + 1
        copied = train.with_segments([replace(s, u=first.u, y=first.y) for s in train.segments])
        for _ in range(2):
            with pytest.raises(DataError, match="repeats training flight"):
                selection.parts_to_choose_on(copied)


def test_a_model_runs_over_equal_data_once() -> None:
    """Gates, and the choice of the baseline, judge the same models over the training data."""
    runs: list[int] = []

    class Counted(HeldValue):
        def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray:
            runs.append(len(u))
            return super().simulate(u, y0)

    train = flown(2)
    first, second = train.segments
    model = Counted(train.dt_s, 1)
    deeper = HeldValue(train.dt_s, 1, n_init=40)
    changed = [
        train.with_segments([first]),
        train.with_segments([first, replace(second, y=2.0 * second.y)]),
        replace(train, dt_s=0.5),
    ]
    with sharing():
        found = selection.free_run_errors({"one": model}, train)["one"]
        once = len(runs)
        again = selection.free_run_errors({"one": model, "other": HeldValue(train.dt_s, 1)}, flown(2))["one"]
        assert (len(runs), again.tobytes()) == (once, found.tobytes())
        for i, data in enumerate(changed):
            before = len(runs)
            anew = selection.free_run_errors({"one": model}, data)["one"]
            assert len(runs) > before, i
            assert anew.tobytes() != found.tobytes(), i
        before = len(runs)
        selection.free_run_errors({"one": model, "deeper": deeper}, train)
        selection.free_run_errors({"one": Counted(train.dt_s, 1)}, train)
        assert len(runs) > before + once
    assert selection.free_run_errors({"one": model}, train)["one"].tobytes() == found.tobytes()
