"""Whether a TS model read from a file holds together, before compiled code follows its indices.

The kernels do not check bounds: a forged column or lag would read memory that is not theirs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from flysid.errors import StoreError
from flysid.model.tslayout import Layout

if TYPE_CHECKING:
    from flysid.model.tsmodel import FittedTS

MAX_LAG = 10_000


def check_layout(layout: Layout) -> None:
    """Orders, delays, antecedents and scaling of a layout.

    Raises
    ------
    StoreError : one is out of its range.
    """
    orders, n_u, n = layout.orders, len(layout.inputs), len(layout.signals)
    if layout.n_y < 1 or len(orders.nb) != n_u or len(orders.nk) != n_u:
        raise StoreError(f"damaged model file: orders of {len(orders.nb)} inputs for {n_u}")
    if not all(_is_lag(value, 0) for value in (orders.na, *orders.nb, *orders.nk)):
        raise StoreError(f"damaged model file: orders out of range: {str(orders)[:80]}")
    for a in layout.antecedents:
        if not _is_lag(a.column, 0) or a.column >= n:
            raise StoreError(f"damaged model file: antecedent of signal {a.column!r:.20} of {n}")
        least = 1 if a.column < layout.n_y else 0
        if not _is_lag(a.lag, least) or not (a.minus == -1 or _is_lag(a.minus, least)):
            raise StoreError("damaged model file: an antecedent's lag is out of range")
    if layout.shift.shape != (n,) or layout.scale.shape != (n,) or not (layout.scale > 0.0).all():
        raise StoreError("damaged model file: the scaling does not fit the signals")


def check(model: FittedTS) -> None:
    """Shapes of all parameters against the layout, which is checked first; raises StoreError."""
    layout, p = model.layout, model.parameters
    check_layout(layout)
    rules, n_z = len(p.theta), len(layout.antecedents)
    n_x = layout.n_y * layout.orders.na + sum(layout.orders.nb) + 1
    wanted = {
        "theta": (rules, layout.n_y, n_x),
        "centre": (rules, n_z),
        "width": (rules, n_z),
        "z_range": (2, n_z),
        "limits": (2, layout.n_y),
    }
    for name, shape in wanted.items():
        found = getattr(p, name)
        if found.shape != shape or not found.flags.c_contiguous or not rules:
            raise StoreError(f"damaged model file: {name} has shape {found.shape}, not {shape}")
    if model.support.shape != (rules,):
        raise StoreError("damaged model file: the rules' support does not fit them")
    if model.noise is not None and (model.noise.ndim != 2 or model.noise.shape[1] != layout.n_y):
        raise StoreError("damaged model file: the noise model does not fit the outputs")


def _is_lag(value: object, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= MAX_LAG
