"""Settings in, refined output-error fits out: delays, orders and the sentences that explain them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from flysid.errors import UsageError
from flysid.model.linear.data import Parts, as_tuple
from flysid.model.linear.model import FittedLinear
from flysid.model.linear.output_error import (
    HIGHEST_ORDER,
    OneOutput,
    assemble,
    choose_orders,
    find_delays,
    refit,
)
from flysid.model.simulation_error import Orders

Auto = Literal["auto"]
SHARE = 10
"""A regression needs this many samples per parameter before an order is tried."""
FEW_INPUTS = 2


class OrderSettings(Protocol):
    """What the search needs to know; `ARX` and `OE` are such settings."""

    @property
    def na(self) -> int | Auto: ...
    @property
    def nb(self) -> int | Sequence[int] | Auto: ...
    @property
    def nk(self) -> int | Sequence[int] | Auto: ...
    @property
    def offset(self) -> bool: ...
    @property
    def n_init(self) -> int | None: ...
    @property
    def nk_hint(self) -> Sequence[int]: ...


@dataclass(frozen=True, eq=False)
class Refined:
    """Fits of the part that choices are made on, ready to become a model of all training data."""

    structure: str
    settings: OrderSettings
    parts: Parts
    fits: tuple[OneOutput, ...]
    note: str

    @property
    def depth(self) -> int:
        """Deepest lag."""
        return max(f.problem.orders.depth for f in self.fits)

    def final(self, notes: Sequence[str] = ()) -> FittedLinear:
        """The chosen orders on all training data."""
        fits = refit(self.parts, self.fits)
        return assemble(self.structure, self.parts, fits, (self.note, *notes), self.settings.n_init)


def check_orders(settings: OrderSettings, n_u: int) -> None:
    """Raise UsageError for orders that cannot be."""
    for name in ("na", "nb", "nk"):
        value = getattr(settings, name)
        if value == "auto":
            continue
        values = tuple(np.atleast_1d(np.asarray(value, dtype=object)))
        if not all(isinstance(v, (int, np.integer)) and v >= 0 for v in values):
            raise UsageError(f"{name} must be whole numbers of at least 0, not {value!r}")
        if (name == "na" or not isinstance(value, int)) and len(values) != (1 if name == "na" else n_u):
            raise UsageError(f"{name} has {len(values)} numbers for {n_u} inputs")
    check_hint(settings.nk_hint, n_u)
    if settings.n_init is not None and settings.n_init < 1:
        raise UsageError(f"n_init must be at least 1, not {settings.n_init}")


def check_hint(nk_hint: Sequence[int], n_u: int) -> None:
    """Raise UsageError unless there is none or one whole number of at least 0 per input."""
    if len(nk_hint) not in (0, n_u) or not all(isinstance(k, int) and k >= 0 for k in nk_hint):
        raise UsageError(f"nk_hint={nk_hint!r}", hint=f"give () or {n_u} whole numbers, one per input")


def search(
    structure: str, settings: OrderSettings, parts: Parts, known_nk: tuple[int, ...] | None = None
) -> Refined:
    """Delays, then orders, on the simulation error.

    Parameters
    ----------
    known_nk : delays found by other means; used where there are so many inputs that a search of their own
        would be slow and unsure.

    Raises
    ------
    FitError : no stable model was found.
    """
    n_y, n_u = len(parts.train.outputs), len(parts.train.inputs)
    longest = max(len(s) for s in parts.fit.segments)
    most = max(1, min(HIGHEST_ORDER, (len(parts.fit) // SHARE - 1) // (1 + n_u), (longest - 2) // 5))
    nas = range(1, most + 1) if settings.na == "auto" else [int(settings.na)]
    delays = [_delays(settings, parts, i, max(nas), known_nk) for i in range(n_y)]
    candidates = [[_orders(settings, na, nk) for nk in delays] for na in nas]
    fits, note = choose_orders(parts, candidates)
    delay = ", ".join(
        f"{s.name} -> {o.name} {k}"
        for o, nk in zip(parts.train.outputs, delays, strict=True)
        for s, k in zip(parts.train.inputs, nk, strict=True)
    )
    words = note or f"order {fits[0].problem.orders.na}"
    return Refined(
        structure,
        settings,
        parts,
        tuple(fits),
        f"Fitted to the simulation error: {words}; delays in samples: {delay}.",
    )


def _delays(
    settings: OrderSettings, parts: Parts, output: int, highest: int, known_nk: tuple[int, ...] | None
) -> tuple[int, ...]:
    n_u = len(parts.train.inputs)
    if settings.nk != "auto":
        return as_tuple(settings.nk, n_u)
    if known_nk is not None and n_u > FEW_INPUTS:
        return known_nk
    probe = min(2, highest)
    counts = as_tuple(probe if settings.nb == "auto" else settings.nb, n_u)
    spoken_for = tuple(settings.nk_hint) or (1,) * n_u
    return find_delays(parts.fit, output, Orders(probe, counts, spoken_for, settings.offset))


def _orders(settings: OrderSettings, na: int, nk: tuple[int, ...]) -> Orders:
    if settings.nb == "auto":
        nb = tuple(max(na, 1) + (1 if k == 0 else 0) for k in nk)
    else:
        nb = as_tuple(settings.nb, len(nk))
    return Orders(na, nb, nk, settings.offset)
