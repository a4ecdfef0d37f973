"""Long records: a part of them, from all over, is enough to look for delays and to start from."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray
from flysid.filters import apply_filter
from flysid.model.linear.output_error import find_delays, fit_output
from flysid.model.simulation_error import OutputError, OutputOrders, Record, find_start

A = np.asarray(np.poly([0.98, 0.84]), dtype=np.float64)
B = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3, -0.2])
ORDERS = OutputOrders(2, (2,), (5,))


def flown(rows: int, *, quiet: float) -> tuple[FloatArray, FloatArray]:
    """Input and output of a lag of second order; for a share of the rows the vehicle stands."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.normal(size=rows // 20 + 1), 20)[:rows]
    u[: int(quiet * rows)] *= 1e-3
    y = apply_filter(B, A, u)
    return u[:, None], y + 0.05 * y.std() * rng.normal(size=rows)


def test_delays_are_those_of_the_part_that_moves() -> None:
    """The first 12,000 rows, which were all that was looked at, held noise: a dead time of 16 for 5."""
    u, y = flown(40_000, quiet=0.4)
    data = Dataset.from_arrays(u, y / y.std(), 0.02)
    assert find_delays(data, 0, OutputOrders(2, (2,), (1,))) == (5,)


def test_a_long_fit_ends_where_a_fit_of_all_rows_does(monkeypatch: pytest.MonkeyPatch) -> None:
    u, y = flown(60_000, quiet=0.1)
    problem = OutputError((Record(u, y),), ORDERS)
    whole = problem.refine(find_start(problem).theta, max_iterations=40)
    seen: list[int] = []
    plain = OutputError.residuals_and_jacobian

    def counting(self: OutputError, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        seen.append(sum(len(r.y) for r in self.records))
        return plain(self, theta)

    monkeypatch.setattr(OutputError, "residuals_and_jacobian", counting)
    found = fit_output(problem)
    assert found.cost <= whole.cost * (1.0 + 1e-6)
    assert np.allclose(found.transfer.a, A, atol=2e-3)
    assert seen.count(60_000) <= 3
    assert seen[0] == pytest.approx(12_000, rel=0.01)


def test_a_part_is_taken_from_every_record_and_from_all_over_long_ones() -> None:
    u, y = flown(60_000, quiet=0.0)
    cuts = [slice(0, 45_000), slice(45_000, 53_000), slice(53_000, 60_000)]
    problem = OutputError(tuple(Record(u[c], y[c]) for c in cuts), ORDERS)
    thin = problem.thinned(12_000)
    assert [len(r.y) for r in thin.records] == [3_000, 3_000, 3_000, 1_600, 1_400]
    starts = [int(np.flatnonzero(y == r.y[0])[0]) for r in thin.records]
    assert starts == [6_000, 21_000, 36_000, 48_200, 55_800]
    assert problem.thinned(20_000) is problem
