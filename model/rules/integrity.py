"""Whether a TS model read from a file holds together, before compiled code follows its indices.

The kernels do not check bounds: a forged column or lag would read memory that is not theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import StoreError
from flysid.model.base import MAX_SIGNALS
from flysid.model.documents import monic
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.regressor_layout import Antecedent, Layout

MAX_LAG = 10_000


def check(layout: Layout, parameters: Parameters, noise: FloatArray | None) -> None:
    """Orders, antecedents, scaling and shapes of a dynamic TS model.

    Raises
    ------
    StoreError : one is out of its range, or does not fit the others.
    ValueError : a noise model that does not begin with 1.
    """
    orders = layout.orders
    n_u = len(layout.inputs)
    n_y = layout.n_y
    n = layout.n
    _require(n_y >= 1 and 0 <= layout.hidden <= MAX_SIGNALS, "states out of range")
    _require(not layout.hidden or orders.na == 1, "hidden states with lags")
    _require(len(orders.nb) == len(orders.nk) == n_u, "orders that do not fit the signals")
    _require(all(_is_lag(value, 0) for value in (orders.na, *orders.nb, *orders.nk)), "orders out of range")
    _require(0.0 <= layout.reach < np.inf, "a reach out of range")
    _check_antecedents(layout.antecedents, n, n + n_u, layout.orders.depth if layout.hidden else MAX_LAG)
    _check_scaling(layout.shift, layout.scale, n + n_u)
    _check_parameters(parameters, (n, n * orders.na + sum(orders.nb) + 1, len(layout.antecedents)))
    if noise is not None:
        _check_noise(noise, n_y)


def _check_antecedents(antecedents: Sequence[Antecedent], states: int, columns: int, most: int) -> None:
    """Columns below `columns`; past values of the first `states` of them, present ones of the others."""
    for a in antecedents:
        _require(_is_lag(a.column, 0) and a.column < columns, "an antecedent of no signal")
        least = 1 if a.column < states else 0
        _require(_is_lag(a.lag, least) and a.lag <= most, "an antecedent's lag out of range")
        _require(
            a.minus == -1 or (_is_lag(a.minus, least) and a.minus <= most), "an antecedent's lag out of range"
        )


def _check_scaling(shift: FloatArray, scale: FloatArray, n: int) -> None:
    _require(shift.shape == scale.shape == (n,) and bool((scale > 0.0).all()), "a scaling of another size")


def _check_parameters(p: Parameters, sizes: tuple[int, int, int]) -> None:
    """Shapes for (outputs, regressors, antecedents)."""
    n, n_x, n_z = sizes
    rules = len(p.theta)
    _require(rules > 0, "no rules")
    wanted = ((rules, n, n_x), (rules, n_z), (rules, n_z), (2, n_z), (2, n))
    for name, array, shape in zip(p._fields, p, wanted, strict=True):
        fits = array.shape == shape and array.flags.c_contiguous
        _require(fits, f"{name} of shape {array.shape}, not {shape}")


def _check_noise(noise: FloatArray, n_y: int) -> None:
    _require(noise.ndim == 2 and noise.shape[1] == n_y, "a noise model of another size")
    _require(bool(np.isfinite(noise).all()), "a noise model that is not finite")
    monic(noise, "noise")


def _require(holds: bool, fault: str) -> None:
    if not holds:
        refuse(fault)


def refuse(fault: str) -> NoReturn:
    """Raise StoreError for a model file whose parts do not fit each other."""
    raise StoreError(f"damaged model file: {fault}", hint="fit again")


def _is_lag(value: object, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= MAX_LAG
