"""Unstable estimates are named; on request they are made stable, the rest of the model fitted again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import Dataset
from flysid.errors import FitError, UsageError
from flysid.model.armax import ARMAX
from flysid.model.arx import ARX
from flysid.model.base import load
from flysid.model.iv import IV
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.stability import made_stable
from flysid.model.oe import OE
from flysid.model.polynomials import NEARLY_ONE
from flysid.model.statespace import StateSpace
from flysid.model.subspace.refinement import mirror
from flysid.model.subspace.triangle import Realisation


def creeping(coupled: bool = False) -> Dataset:
    """A plant with a pole just outside the circle, over spans so short that this hardly shows."""
    rng = np.random.default_rng(0)
    us = []
    ys = []
    for _ in range(4):
        u = np.repeat(rng.choice([-1.0, 1.0], (40, 2)), 5, axis=0)
        y = np.zeros((200, 2))
        for k in range(1, 200):
            y[k, 0] = 1.004 * y[k - 1, 0] + 0.1 * u[k - 1, 0] + (0.02 * y[k - 1, 1] if coupled else 0.0)
            y[k, 1] = 0.9 * y[k - 1, 1] + 0.2 * u[k - 1, 1] + (0.01 * y[k - 1, 0] if coupled else 0.0)
        us.append(u if coupled else u[:, :1])
        ys.append((y + 1e-3 * rng.standard_normal(y.shape))[:, : 2 if coupled else 1])
    return Dataset.from_arrays(us, ys, 0.05)


@pytest.mark.parametrize("coupled", [False, True])
def test_an_unstable_estimate_is_named_and_made_stable(coupled: bool, tmp_path: object) -> None:
    data = creeping(coupled)
    loose = ARX(na=1, nb=1, nk=1, refine=False).fit(data)
    assert not loose.is_stable
    assert any("Unstable: the largest pole radius is 1.0" in note for note in loose.notes)
    assert any("stable=True" in note for note in loose.notes)
    held = ARX(na=1, nb=1, nk=1, refine=False, stable=True).fit(data)
    assert float(np.abs(held.poles).max()) <= NEARLY_ONE + 1e-9
    assert any("Made stable" in note for note in held.notes)
    assert np.isfinite(held.standard_errors).all()
    long = np.ones((100_000, 2 if coupled else 1))
    first = np.zeros((held.n_init, len(held.outputs)))
    assert np.isfinite(held.simulate(long, first)).all()
    low, high = held.simulation_band(long[:50], first, draws=20)
    assert (low <= high).all()
    held.save(tmp_path / "held.json")  # type: ignore[operator]
    assert load(tmp_path / "held.json").notes == held.notes  # type: ignore[operator]


def test_a_state_space_and_an_instrumental_estimate_are_made_stable_on_request() -> None:
    data = creeping()
    for settings in (
        StateSpace(order=1, method="pbsid", past=3, refine=False, feedthrough=False, nk=1),
        IV(na=1, nb=1, nk=1),
    ):
        loose = settings.fit(data)
        held = replace(settings, stable=True).fit(data)
        assert not loose.is_stable
        assert any("Unstable" in note and "stable=True" in note for note in loose.notes)
        assert held.is_stable
        assert any("Made stable" in note for note in held.notes)
        s = data.segments[0]
        miss = held.simulate(s.u, s.y[: held.n_init]) - s.y
        assert np.std(miss[held.n_init :]) < 0.6 * s.y.std()  # 1.004^200 is not 0.996^200
    two = np.diag([1.1, 0.5]) + np.eye(2, k=1)
    still = Realisation(*(np.zeros((2, 2)) for _ in range(9)))
    assert np.abs(np.linalg.eigvals(mirror(replace(still, a=two)).a)).max() == pytest.approx(1 / 1.1)


def test_a_drift_of_every_segment_is_estimated_or_taken_out() -> None:
    """The plant's gain is 1; the drift would pull it far off."""
    rng = np.random.default_rng(0)
    us = []
    ys = []
    for slope in (2e-3, -3e-3):
        u = np.repeat(rng.choice([-1.0, 1.0], 60), 10)
        y = lfilter([0.0, 0.1], [1.0, -0.9], u) + slope * np.arange(600) + 0.02 * rng.standard_normal(600)
        us.append(u)
        ys.append(y)
    data = Dataset.from_arrays(us, ys, 0.05)
    found = OE(na=1, nb=1, nk=1, trend="estimate").fit(data)
    assert found.dc_gain[0, 0] == pytest.approx(1.0, abs=4 * gain_error(found))
    assert gain_error(found) < 0.01
    for settings in (ARMAX(na=1, nb=1, nk=1, nc=1, trend="remove"), IV(na=1, nb=1, nk=1, trend="remove"),
                     StateSpace(order=1, nk=1, trend="remove")):  # fmt: skip
        assert settings.fit(data).dc_gain[0, 0] == pytest.approx(1.0, abs=0.1)
    with pytest.raises(UsageError, match="trend is 'estimate'"):
        ARMAX(trend="estimate").fit(data)


def gain_error(model: FittedLinear) -> float:
    """Standard error of the steady gain."""
    return float(model.frequency_response(np.zeros(1)).magnitude_error[0, 0, 0])


def test_the_rest_is_fitted_again() -> None:
    data = creeping()
    loose = ARX(na=1, nb=1, nk=1, refine=False).fit(data)
    held = made_stable(loose, data)
    only_mirrored = replace(loose, system=replace(loose.system, a=held.system.a), starts=None)

    def miss(model: object) -> float:
        runs = [model.simulate(s.u, s.y[:1]) - s.y for s in data.segments]  # type: ignore[attr-defined]
        return float(np.sqrt(np.mean(np.concatenate(runs) ** 2)))

    assert miss(held) < miss(only_mirrored)


def test_a_stable_estimate_is_left_as_it_is() -> None:
    rng = np.random.default_rng(1)
    u = rng.standard_normal(500)
    data = Dataset.from_arrays(u, lfilter([0.0, 0.2], [1.0, -0.8], u) + 0.01 * rng.standard_normal(500), 0.1)
    plain, held = (ARX(na=1, nb=1, nk=1, refine=False, stable=s).fit(data) for s in (False, True))
    assert np.array_equal(plain.flat, held.flat)
    assert plain.notes == held.notes
    assert ARMAX(na=1, nb=1, nk=1, nc=1, stable=True).fit(data).is_stable


def test_segments_that_are_too_short_are_named() -> None:
    data = creeping()
    loose = ARX(na=1, nb=1, nk=1, refine=False).fit(data)
    short = data.with_segments([s.slice(0, 4, data.dt_s) for s in data.segments])
    with pytest.raises(FitError, match="long enough"):
        made_stable(loose, short)


@pytest.mark.parametrize("structure", [ARX, OE])
def test_a_drift_is_taken_out_on_request(structure: type[ARX] | type[OE]) -> None:
    rng = np.random.default_rng(2)
    u = np.repeat(rng.choice([-1.0, 1.0], 200), 5) + 2.0
    y = lfilter([0.0, 0.1], [1.0, -0.95], u) + 0.01 * np.arange(1000) + 1e-3 * rng.standard_normal(1000)
    data = Dataset.from_arrays(u, y, 0.05)
    bent, straight = (structure(na=1, nb=1, nk=1, trend=t).fit(data) for t in ("none", "remove"))
    assert abs(straight.poles[0] - 0.95) < 0.2 * abs(bent.poles[0] - 0.95)
    assert abs(straight.poles[0] - 0.95) < 0.01
    with pytest.raises(UsageError, match=r"trend is .*, not 'away'"):
        structure(trend="away").fit(data)  # type: ignore[arg-type]
