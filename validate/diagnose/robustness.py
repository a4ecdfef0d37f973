"""What a model does far from the record: long runs under bounded random input, and forgetting its start.

Both use nothing but `simulate`, so they hold for every structure. A common quadratic Lyapunov function proves
more where one is found (`flysid.model.rules.local_models`); these tries show what it cannot prove.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.base import Fitted


@dataclass(frozen=True)
class Robustness:
    """Free runs that no record tells of.

    Attributes
    ----------
    long_s : length of the long run.
    limits_s : when it reached the output limits; None where it never did.
    outside : share of its samples outside the training range of any output.
    forget_s : seconds until two runs from the opposite ends of the training range stay within 1 % of that
        range; None where they do not within `forget_most_s`.
    """

    long_s: float
    limits_s: float | None
    outside: float
    forget_s: float | None
    forget_most_s: float


def robustness(
    model: Fitted, data: Dataset, seed: int = 0, *, samples: int = 20_000, forget_samples: int = 4000
) -> Robustness:
    """Try a model with inputs drawn from the range of `data`."""
    rng = np.random.default_rng(seed)
    low, high = _range(data, "y")
    u = random_steps(*_range(data, "u"), samples, rng)
    y = _run(model, u, 0.5 * (low + high))
    least, most = model.output_limits
    at = np.flatnonzero(((y <= least) | (y >= most) | ~np.isfinite(y)).any(axis=1)[model.n_init :])
    beyond = ((y < low) | (y > high)).any(axis=1)
    return Robustness(
        long_s=samples * model.dt_s,
        limits_s=float((at[0] + model.n_init) * model.dt_s) if len(at) else None,
        outside=float(np.mean(beyond)),
        forget_s=_forgets(model, u[:forget_samples], low, high),
        forget_most_s=forget_samples * model.dt_s,
    )


def random_steps(
    low: FloatArray,
    high: FloatArray,
    n: int,
    rng: np.random.Generator,
    *,
    shortest: int = 5,
    longest: int = 100,
) -> FloatArray:
    """(n, n_u) uniform heights between low and high, every input held 5 to 100 samples at a time."""
    columns = []
    for a, b in zip(low, high, strict=True):
        holds = rng.integers(shortest, longest + 1, size=n // shortest + 1)
        columns.append(np.repeat(rng.uniform(a, b, size=len(holds)), holds)[:n])
    return np.stack(columns, axis=1)


def _forgets(
    model: Fitted, u: FloatArray, low: FloatArray, high: FloatArray, *, near_share: float = 0.01
) -> float | None:
    with np.errstate(invalid="ignore"):  # infinities, of a model that breaks the laws
        apart = np.abs(_run(model, u, high) - _run(model, u, low))
    near = apart <= near_share * np.where(high > low, high - low, 1.0)  # False where not a number
    last = model.n_init + np.flatnonzero(~near[model.n_init :].all(axis=1))
    if len(last) and last[-1] == len(apart) - 1:
        return None
    return float((last[-1] + 1) * model.dt_s) if len(last) else 0.0


def _run(model: Fitted, u: FloatArray, start: FloatArray) -> FloatArray:
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # a model that breaks the laws is told of, not warned of
        return model.simulate(u, np.tile(start, (model.n_init, 1)))


def _range(data: Dataset, side: str) -> tuple[FloatArray, FloatArray]:
    """(low, high) of every input ("u") or output ("y") over all segments."""
    low = np.min([getattr(s, side).min(axis=0) for s in data.segments if len(s)], axis=0)
    high = np.max([getattr(s, side).max(axis=0) for s in data.segments if len(s)], axis=0)
    return low, high
