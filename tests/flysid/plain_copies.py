"""Whether two flights are the same, as `flysid.leakage.alike` states it: pair by pair, with NumPy alone."""

from __future__ import annotations

import numpy as np

from flysid.leakage.alike import (
    LEAST_CORRELATION,
    LEAST_NOISE,
    LEAST_OVERLAP,
    NEIGHBOURS,
    NOISE_SHARE,
    SAME_GAIN,
    SAME_INPUT,
    SAME_OUTPUT,
    SAME_SHARE,
    SIGMAS,
    Grid,
)
from flysid.stretch import FloatArray


def are_same(theirs: Grid, mine: Grid) -> bool:
    """Whether they share their noise, or their outputs agree."""
    return _share_noise(theirs, mine) or _share_outputs(theirs, mine)


def _share_noise(theirs: Grid, mine: Grid) -> bool:
    for a, b in zip(theirs.e.T, mine.e.T, strict=True):
        if not (np.isfinite(a).any() and np.isfinite(b).any()):
            continue
        x, z = _overlapping(_scaled(a), _scaled(b), _best_lag(a, b))
        if len(x) < max(LEAST_NOISE, NOISE_SHARE * mine.samples) or not (np.ptp(x) and np.ptp(z)):
            continue
        rho = float(np.corrcoef(x, z)[0, 1])
        chance = np.sqrt(2.0 * np.log(len(a) + len(b)))
        if rho > LEAST_CORRELATION and rho * np.sqrt(len(x)) > chance + SIGMAS:
            return True
    return False


def _share_outputs(theirs: Grid, mine: Grid) -> bool:
    if min(theirs.flown, mine.flown) < LEAST_OVERLAP:
        return False
    outputs = list(zip(theirs.y.T, mine.y.T, strict=True))
    moves = [(np.diff(a), np.diff(b)) for a, b in outputs]
    least = max(LEAST_OVERLAP, SAME_SHARE * mine.flown) - 1
    lags = {_best_lag(a, b) for a, b in [*outputs, *moves]} | {_closest_lag(a, b, least) for a, b in moves}
    return any(_agree(theirs, mine, lag) for lag in lags)


def _agree(theirs: Grid, mine: Grid, lag: int) -> bool:
    moving = [(a, b) for a, b in zip(theirs.y.T, mine.y.T, strict=True) if np.ptp(b[np.isfinite(b)])]
    for a, b in moving:
        x, z = _overlapping(a, b, lag)
        size = float(np.nanmax(np.abs(b)))
        limit = SAME_OUTPUT * float(np.nanstd(b / size))
        if len(x) < max(LEAST_OVERLAP, SAME_SHARE * mine.flown) or _apart(x / size, z / size, limit):
            return False
    inputs = (_overlapping(a, b, lag) for a, b in zip(theirs.u.T, mine.u.T, strict=True))
    return bool(moving) and all(
        not (x != z).any() or not _apart(x, z, SAME_INPUT * z.std()) for x, z in inputs
    )


def _apart(x: FloatArray, z: FloatArray, limit: float) -> bool:
    return _filtered_apart(x, z, limit) and _filtered_apart(z, x, limit)


def _filtered_apart(x: FloatArray, z: FloatArray, limit: float) -> bool:
    rows = len(x) - 2 * NEIGHBOURS
    near = [z[k : k + rows] for k in range(2 * NEIGHBOURS + 1)]
    columns = np.stack([np.ones(rows), *near], axis=1)
    wanted = x[NEIGHBOURS : NEIGHBOURS + rows]
    weights = np.linalg.lstsq(columns, wanted, rcond=None)[0]
    left = float(np.linalg.norm(wanted - columns @ weights))
    is_far = left > limit * np.sqrt(max(rows - columns.shape[1], 1))
    return bool(is_far or abs(weights[1:].sum() - 1.0) > SAME_GAIN)


def _scaled(x: FloatArray) -> FloatArray:
    return np.asarray(x / (np.nanmax(np.abs(x)) or 1.0))


def _products(a: FloatArray, b: FloatArray) -> FloatArray:
    """Sums of products at lags of b behind a from -(len(b) - 1) on; gaps count as 0."""
    return np.correlate(np.nan_to_num(a), np.nan_to_num(b), "full")


def _best_lag(a: FloatArray, b: FloatArray) -> int:
    a, b = (_scaled(x) - np.nanmean(_scaled(x)) for x in (a, b))
    return int(np.argmax(_products(a, b))) - len(b) + 1


def _closest_lag(a: FloatArray, b: FloatArray, least: float) -> int:
    size = max(np.nanmax(np.abs(a)), np.nanmax(np.abs(b))) or 1.0
    a, b = a / size, b / size
    known, own = (np.isfinite(x).astype(float) for x in (a, b))
    gap = _products(a**2, own) + _products(known, b**2) - 2.0 * _products(a, b)
    count = np.round(_products(known, own))
    mean = np.where(count > least - 0.5, gap / np.maximum(count, 1.0), np.inf)
    return int(np.argmin(mean)) - len(b) + 1


def _overlapping(a: FloatArray, b: FloatArray, lag: int) -> tuple[FloatArray, FloatArray]:
    x, z = a[max(lag, 0) :], b[max(-lag, 0) :]
    common = min(len(x), len(z))
    both = np.isfinite(x[:common]) & np.isfinite(z[:common])
    return x[:common][both], z[:common][both]
