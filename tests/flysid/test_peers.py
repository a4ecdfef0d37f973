"""Estimates equal those of others that solve the same equations: NumPy; Octave, SIPPY where installed."""

from __future__ import annotations

import numpy as np
import pytest

from bench.octave import ARX as OCTAVE_ARX
from bench.octave import octave
from flysid.dataset import Dataset, FloatArray
from flysid.model.arx import ARX


def record(rows: int = 3000, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Two inputs, one output of fourth order."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((rows, 2))
    y = np.zeros((rows, 1))
    e = 0.1 * rng.standard_normal(rows)
    for k in range(4, rows):
        past = y[k - 4 : k, 0][::-1]
        y[k, 0] = past @ [1.5, -0.7, 0.1, -0.05] + u[k - 1] @ [1.0, 0.3] + 0.5 * u[k - 2, 0] + e[k]
    return u, y


def ours(u: FloatArray, y: FloatArray) -> FloatArray:
    """a1..a4, then b1..b4 of every input."""
    settings = ARX(na=4, nb=4, nk=1, offset=False, refine=False)
    system = settings.fit(Dataset.from_arrays(u, y, 0.01)).system
    return np.concatenate([system.a[1:, 0, 0], *(system.b[1:, 0, j] for j in range(u.shape[1]))])


def test_arx_solves_the_least_squares_that_numpy_solves() -> None:
    u, y = record()
    columns = [-y[4 - i : len(y) - i, 0] for i in range(1, 5)]
    columns += [u[4 - i : len(u) - i, j] for j in range(2) for i in range(1, 5)]
    best = np.linalg.lstsq(np.column_stack(columns), y[4:, 0], rcond=None)[0]
    assert ours(u, y) == pytest.approx(best, abs=1e-10)


def test_arx_is_that_of_octave() -> None:
    u, y = record()
    found = octave(OCTAVE_ARX.format(na=4, nb=4), u, y)
    if found is None:
        pytest.skip("octave with its control package is not installed")
    assert ours(u, y) == pytest.approx(found, abs=1e-8)


@pytest.mark.filterwarnings("ignore")
def test_arx_is_that_of_sippy() -> None:
    peer = pytest.importorskip("sippy_unipi", exc_type=ImportError)
    u, y = record()
    found = peer.system_identification(
        y.T, u[:, :1].T, "ARX", ARX_orders=[4, 4, 0], ARX_mod="LLS", tsample=0.01
    )
    theirs = [*found.DENOMINATOR[0][0][1:5], *found.NUMERATOR[0][0][:4]]
    assert ours(u[:, :1], y) == pytest.approx(theirs, abs=1e-8)
