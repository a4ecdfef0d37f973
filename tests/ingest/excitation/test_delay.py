from collections.abc import Sequence

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.errors import DataError
from flysid.ingest.excitation.delay import cross_correlation, estimate_delay
from flysid.ingest.excitation.delay_fits import (
    ARX_ORDERS,
    Piece,
    _refine,
    predictors,
    searched_free_runs,
)

DT = 0.02


def lagged(
    delay_s: float, noise: float = 0.02, gain: float = 1.0, tau_s: float = 0.3, seed: int = 0
) -> Dataset:
    """A first-order lag behind a dead time, simulated at a tenth of the sample time."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(seed)
    fine = DT / 10
    steps = 10
    u = np.repeat(rng.normal(size=240), 25 * steps)
    late = np.concatenate([np.zeros(round(delay_s / fine)), u])[: len(u)]
    pole = np.exp(-fine / tau_s)
    y = lfilter([0.0, gain * (1 - pole)], [1.0, -pole], late)[::steps]
    return Dataset.from_arrays(u[::steps], y + noise * rng.normal(size=len(y)), DT)


@pytest.mark.parametrize("delay_s", [0.0, 0.031, 0.08, 0.15])
def test_dead_time_is_found_within_a_sample_although_the_lag_is_longer(delay_s: float) -> None:
    found = estimate_delay(lagged(delay_s))
    assert abs(found.delay_s - delay_s) <= DT
    assert found.low_s <= delay_s + DT / 2
    assert found.high_s >= delay_s - DT / 2
    assert found.peak_s > delay_s + 0.05  # the peak of the correlation is not the dead time


def late_plant(
    poles: Sequence[complex], late: int, drive: str, noise: float, dt_s: float = 0.004, seed: int = 0
) -> list[Piece]:
    """24 s of real poles behind a dead time in samples, with white noise on the output, in two segments."""
    from scipy.signal import butter, lfilter

    rng = np.random.default_rng(seed)
    n = round(24.0 / dt_s)
    u = rng.normal(size=n)
    if drive == "sticks":
        u = lfilter(*butter(2, 2 * 3.0 * dt_s), u)
    if drive == "steps":
        u = np.repeat(rng.normal(size=48), round(0.5 / dt_s))
    y = lfilter([1.0], np.real(np.poly(poles)), np.concatenate([np.zeros(late), u])[:n])
    y = y / y.std() + noise * rng.normal(size=n)
    parts = zip(np.split(u, [n // 3]), np.split(y, [n // 3]), strict=True)
    return [(u - u.mean(), y - y.mean()) for u, y in parts]


RESONANT = (0.98 * np.exp(0.08j), 0.98 * np.exp(-0.08j))


@pytest.mark.parametrize(
    ("drive", "poles", "late", "noise"),
    [
        ("white", (), 61, 0.3),
        ("white", (0.97,), 94, 1.0),
        ("white", RESONANT, 0, 0.05),
        ("sticks", (), 94, 0.3),
        ("sticks", (0.97,), 61, 0.05),
        ("sticks", (0.93, 0.9), 61, 0.05),
        ("sticks", RESONANT, 13, 0.3),
        ("steps", (0.93, 0.9), 0, 0.05),
        ("steps", RESONANT, 61, 0.05),
    ],
)
def test_few_free_runs_find_what_all_dead_times_would_give(
    drive: str, poles: Sequence[complex], late: int, noise: float
) -> None:
    pieces = late_plant(poles, late, drive, noise)
    slack = 4.0 / np.sqrt(sum(len(y) for _, y in pieces))
    fits = searched_free_runs(pieces, 125, slack)
    best = min(fits, key=lambda nk: fits[nk].error)
    good = [nk for nk in fits if fits[nk].error <= fits[best].error * (1.0 + slack)]
    assert min(good) - 1 <= late <= max(good)
    assert len(fits) < 40
    from_far = {nk: _refine(pieces, nk, fits[best].poles, 127, slack) for nk in range(0, 126, 9)}
    assert min(fit.error for fit in from_far.values()) >= fits[best].error * (1.0 - 0.1 * slack)
    as_good = [nk for nk, fit in from_far.items() if fit.error <= fits[best].error * (1.0 + 0.9 * slack)]
    assert all(min(good) <= nk <= max(good) for nk in as_good)


def test_predictors_are_those_of_plain_least_squares() -> None:
    pieces = late_plant([0.97], 13, "white", 0.3, seed=3)
    fits = predictors(pieces, 40)
    na, nb = ARX_ORDERS
    first = 40 + nb - 1
    for nk in (0, 7, 40):
        rows = np.concatenate(
            [
                np.stack(
                    [-y[first - i : len(y) - i] for i in range(1, na + 1)]
                    + [u[first - nk - i : len(u) - nk - i] for i in range(nb)],
                    axis=1,
                )
                for u, y in pieces
            ]
        )
        target = np.concatenate([y[first:] for _, y in pieces])
        theta, squares, _, _ = np.linalg.lstsq(rows, target, rcond=None)
        assert fits[nk].error == pytest.approx(squares[0] / len(target), rel=1e-9)
        np.testing.assert_allclose(fits[nk].poles[1:], theta[:na], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(fits[nk].zeros[nk:], theta[na:], rtol=1e-6, atol=1e-9)


def test_the_sign_of_the_relation_is_told() -> None:
    assert estimate_delay(lagged(0.08, gain=-3.0)).sign == -1
    assert estimate_delay(lagged(0.08, gain=2.0)).sign == 1


def test_cross_correlation_peaks_at_a_pure_delay() -> None:
    rng = np.random.default_rng(2)
    u = rng.normal(size=(2, 500))
    data = Dataset.from_arrays(list(u), [np.roll(x, 7) for x in u], DT)
    lag_s, r = cross_correlation(data, max_lag_s=0.5)
    assert lag_s[np.argmax(r)] == pytest.approx(7 * DT)
    assert r.max() > 0.95
    assert np.abs(r).max() <= 1.0 + 1e-12


def test_what_cannot_be_estimated_is_refused() -> None:
    with pytest.raises(DataError, match="too short"):
        estimate_delay(Dataset.from_arrays(np.ones(5), np.ones(5), DT))
    with pytest.raises(DataError, match="moving"):
        estimate_delay(Dataset.from_arrays(np.zeros(500), np.ones(500), DT))
