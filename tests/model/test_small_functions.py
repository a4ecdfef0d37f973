"""Small functions of models, by table."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray
from flysid.model.documents import array_of
from flysid.model.freerun import Difference
from flysid.model.last_gates import HeldValue
from flysid.model.linear.data import Parts
from flysid.model.linear.initial_state import Past, equation_starts, responses, start_gain
from flysid.model.selection import judge_free_runs
from flysid.model.statespace import StateSpace
from flysid.model.subspace.triangle import default_past, window


@pytest.mark.parametrize(
    ("value", "shape", "found"),
    [
        ([[1, 2], [3, 4]], (2, 2), (2, 2)),
        ([[1, 2], [3, 4]], (-1, 2), (2, 2)),
        ([[1, 2], [3, 4]], (2, 3), None),
        ([1, 2], (1, 2), None),
        ([], (0, 3), (0, 3)),  # lists in lists do not tell what is empty of what
        ([], (-1, 3), (0, 3)),
        ([[], []], (2, 0), (2, 0)),
        ([[], []], (3, 0), None),
        ([], (2,), None),
        ([1.0, float("nan")], (2,), None),
        ([1.0, float("inf")], (2,), None),
    ],
    ids=str,
)
def test_an_array_of_a_document_has_its_shape(
    value: object, shape: tuple[int, ...], found: tuple[int, ...] | None
) -> None:
    if found is None:
        with pytest.raises(ValueError, match="not a finite array of shape"):
            array_of({"a": value}, "a", *shape)
    else:
        assert array_of({"a": value}, "a", *shape).shape == found


@pytest.mark.parametrize(
    ("order", "n_y", "lengths", "past"),
    [
        (2, 1, [1000], 10),  # at least 10
        (6, 1, [1000], 12),  # twice the order
        (2, 1, [160], 8),  # ten rows for every column: 160 / (10 x 2)
        (4, 1, [40], 5),  # what the order needs
        (4, 2, [40], 3),
        (2, 1, [20, 28, 4] * 10, 7),  # a quarter of the longest
        (0, 1, [3], 1),
    ],
)
def test_how_far_a_subspace_looks_back(order: int, n_y: int, lengths: list[int], past: int) -> None:
    assert default_past(order, n_y, 1, lengths) == past


def test_what_a_method_looks_back_on_in_all() -> None:
    assert (window(10, "pbsid"), window(10, "n4sid"), window(1, "n4sid")) == (10, 19, 1)


def test_a_refinement_is_kept_where_it_free_runs_better() -> None:
    rng = np.random.default_rng(4)
    u = np.repeat(rng.normal(size=120), 5)
    y = np.zeros(len(u))
    for k in range(2, len(u)):
        y[k] = 1.6 * y[k - 1] - 0.68 * y[k - 2] + 0.1 * u[k - 1]
    kept = []
    for noise in (0.02, 0.6):
        data = Dataset.from_arrays(u, y + noise * rng.normal(size=len(y)), 0.02)
        model = StateSpace(order=2, past=8, method="pbsid", refine="auto").fit(data)
        (note,) = [n for n in model.notes if "refined against" in n]
        words = note.split()
        at = words.index("refined")
        assert (float(words[at - 1]) < float(words[at + 2])) is not ("not kept" in note)
        kept.append("not kept" not in note)
    assert True in kept


def test_a_start_is_the_least_mean_square_estimate() -> None:
    """P H' (H P H' + s^2 I)^-1, of states of mean square P that outputs see through H with noise s."""
    single = Difference(np.array([1.0, -1.5, 0.7]).reshape(3, 1, 1), np.ones((2, 1, 1)), np.zeros(1))
    states = np.random.default_rng(1).normal(size=(50, 2)) @ np.array([[1.0, 0.5], [0.0, 2.0]])
    seen = responses(single, 6)
    assert seen[:, 0] == pytest.approx(single.respond(np.zeros((6, 1)), np.array([[1.0], [0.0]]))[:, 0])
    spread = states.T @ states / 50
    whole = seen @ spread @ seen.T + 0.3**2 * np.eye(6)
    assert start_gain(Past(single, states, 0.3), 6) == pytest.approx(spread @ seen.T @ np.linalg.inv(whole))


@pytest.mark.parametrize(
    ("roots", "feeds", "noise", "does"),
    [
        ((0.99, 0.5), 0.0, 0.1, True),
        ((0.99, 1.01), 0.0, 0.1, False),  # one output's equation is not stable
        ((0.99, 0.5), 0.2, 0.1, False),  # one output feeds the other
        ((0.99, 0.5), 0.0, 0.0, False),  # lags as measured are exact
    ],
)
def test_lags_are_estimated_where_that_is_better(
    roots: tuple[float, float], feeds: float, noise: float, does: bool
) -> None:
    a = np.array([np.eye(2), [[-roots[0], feeds], [0.0, -roots[1]]]])
    system = Difference(a, np.array([np.zeros((2, 1)), [[0.1], [0.4]]]), np.zeros(2))
    rng = np.random.default_rng(2)
    u = rng.normal(size=(200, 1))
    y = system.run(u, np.zeros((1, 2)))
    data = Dataset.from_arrays(u, y + noise * rng.normal(size=y.shape), 0.02)
    parts = Parts.of(data, None)
    scaling = parts.scaling
    rest = system.b.sum(axis=0) @ scaling.u_origin - system.a.sum(axis=0) @ scaling.y_origin
    b = system.b * scaling.u_scale / scaling.y_scale[:, None]
    gains = equation_starts(Difference(a, b, rest / scaling.y_scale), parts, 4)
    assert (gains is not None) is does
    if gains is not None:
        assert gains.shape == (2, 1, 4)


class _Held(HeldValue):
    """The first value held, within limits."""

    @property
    def output_limits(self) -> FloatArray:
        return np.array([[-10.0], [3.0]])


@pytest.mark.parametrize(
    ("levels", "reached"), [((1.0, 2.0), False), ((1.0, 3.0), True), ((-10.0, 2.0), True)]
)
def test_a_free_run_that_was_ever_at_its_limits_is_told(levels: tuple[float, ...], reached: bool) -> None:
    """Errors are in variances of the outputs, here of a step of one around each level's mean."""
    us = [np.zeros(400)] * 2
    ys = [np.concatenate([np.full(200, level), np.full(200, level + 1.0)]) for level in levels]
    data = Dataset.from_arrays(us, ys, 0.02)
    found = judge_free_runs({"held": _Held(0.02, 1), "free": HeldValue(0.02, 1)}, data)
    assert [found[name][1] for name in ("held", "free")] == [reached, False]
    errors = found["free"][0]
    assert errors[0] == 0.0  # nothing has moved yet
    assert errors.max() == pytest.approx(1.0 / np.var(np.concatenate(ys)), rel=0.05)
