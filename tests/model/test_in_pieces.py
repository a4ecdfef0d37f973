"""What comes in pieces is predicted as the whole record is."""

from __future__ import annotations

import numpy as np
import pytest

import flysid
from flysid.dataset import FloatArray
from flysid.model.in_pieces import in_pieces
from flysid.model.noise import output_error_ahead
from tests.fakes import FirstOrder
from tests.model.test_flight_offsets import in_wind
from tests.model_examples import EXAMPLES, fitted


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_pieces_are_predicted_as_the_whole(name: str) -> None:
    sizes = (1, 1, 2, 60, 7, 23)
    model = fitted(name)
    segment = EXAMPLES[name][1].segments[0]
    ahead = in_pieces(model)
    found: list[FloatArray] = []
    at = 0
    while at < len(segment):
        size = sizes[len(found) % len(sizes)]
        found.append(ahead.feed(segment.u[at : at + size], segment.y[at : at + size]))
        at += size
    whole = model.predict(segment.u, segment.y, 1)
    size = np.nanmax(np.abs(whole))
    np.testing.assert_allclose(np.concatenate(found), whole, rtol=0, atol=1e-9 * size)


@pytest.mark.parametrize("structure", ["theirs", "arx"])
def test_a_class_from_elsewhere_is_predicted_from_its_latest_seconds(structure: str) -> None:
    model = FirstOrder(structure=structure)
    rng = np.random.default_rng(1)
    u = rng.standard_normal((600, 1))
    y = rng.standard_normal((600, 1))
    ahead = in_pieces(model)
    found = np.concatenate([ahead.feed(u[k : k + 7], y[k : k + 7]) for k in range(0, 600, 7)])
    np.testing.assert_allclose(found, model.predict(u, y, 1), atol=1e-12)


def test_a_record_shorter_than_its_noise_model_is_predicted() -> None:
    """Of an error of so high an order, only what has been seen counts."""
    noise = np.concatenate([np.ones((1, 1)), np.full((8, 1), -0.1)])
    free = np.zeros((3, 1))
    y = np.array([[1.0], [2.0], [4.0]])
    np.testing.assert_allclose(output_error_ahead(free, y, noise, 1), [[0.0], [0.1], [0.3]])


def test_wind_is_no_fault() -> None:
    """A flight in stronger wind than any of training is predicted as well, once the wind is known."""
    model = flysid.ARX().fit(in_wind())
    errors = {}
    for wind in (0.0, 4.0):
        segment = in_wind((wind,), seed=3).segments[0]
        ahead = in_pieces(model)
        pieces = [slice(k, k + 20) for k in range(0, len(segment), 20)]
        found = np.concatenate([segment.y[p] - ahead.feed(segment.u[p], segment.y[p]) for p in pieces])
        assert np.isnan(found[: model.n_init]).all()
        errors[wind] = found[200:]
    assert np.isfinite(errors[4.0]).all()
    assert errors[4.0].std() == pytest.approx(errors[0.0].std(), rel=0.1)
    assert abs(errors[4.0].mean()) < 0.02
