"""Settings in, refined output-error fits out: delays, orders and the sentences that explain them."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

from flysid.model.linear.data import Parts, as_tuple
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.output_error import (
    HIGHEST_ORDER,
    OneOutput,
    assemble,
    choose_orders,
    find_delays,
    refit,
)
from flysid.model.linear.settings import PolynomialSettings
from flysid.model.shared import digest, once, sharing
from flysid.model.simulation_error import OutputOrders

SHARE = 10
"""A regression needs this many samples per parameter before an order is tried."""
FEW_INPUTS = 2


@dataclass(frozen=True, eq=False)
class Refined:
    """Fits of the part that choices are made on, ready to become a model of all training data."""

    structure: str
    settings: PolynomialSettings
    parts: Parts
    fits: tuple[OneOutput, ...]
    note: str

    @property
    def depth(self) -> int:
        """Deepest lag."""
        return max(f.problem.orders.depth for f in self.fits)

    def final(self, notes: Sequence[str] = ()) -> FittedLinear:
        """The chosen orders on all training data."""
        fits = _refit(self.parts, self.fits)
        return assemble(self.structure, self.parts, fits, (self.note, *notes), self.settings.n_init)


def search(
    structure: str, settings: PolynomialSettings, parts: Parts, known_nk: tuple[int, ...] | None = None
) -> Refined:
    """Delays, then orders, on the simulation error.

    `known_nk`: delays found by other means; used where there are so many inputs that a search of their own
        would be slow and unsure.
    Raises FitError: no stable model was found.
    """
    fits, note = _search(settings, parts, known_nk if len(parts.train.inputs) > FEW_INPUTS else None)
    return Refined(structure, settings, parts, fits, note)


def _ask(settings: PolynomialSettings, parts: Parts, known_nk: tuple[int, ...] | None) -> Hashable:
    """What a search depends on: ARX, OE, ARMAX and Box-Jenkins ask for the same one."""
    s = settings
    given = (s.na, s.nb, s.nk, s.offset, tuple(s.nk_hint), s.trend == "estimate")
    return repr(given), known_nk, _data(parts)


def _data(parts: Parts) -> Hashable:
    return parts.seed, digest(parts.train), None if parts.validation is None else digest(parts.validation)


@once(_ask)
@sharing()  # outputs whose delays stay are fitted once
def _search(
    settings: PolynomialSettings, parts: Parts, known_nk: tuple[int, ...] | None
) -> tuple[tuple[OneOutput, ...], str]:
    n_y = len(parts.train.outputs)
    n_u = len(parts.train.inputs)
    longest = max(len(s) for s in parts.fit.segments)
    most = max(1, min(HIGHEST_ORDER, (len(parts.fit) // SHARE - 1) // (1 + n_u), (longest - 2) // 5))
    nas = range(1, most + 1) if settings.na == "auto" else [int(settings.na)]

    def at(delays: Sequence[tuple[int, ...]]) -> tuple[list[OneOutput], str]:
        return choose_orders(parts, [[_orders(settings, na, nk) for nk in delays] for na in nas])

    delays = [_delays(settings, parts, i, min(2, max(nas)), known_nk) for i in range(n_y)]
    fits, note = at(delays)
    # what a model of two lags takes for dead time may be a third lag
    settled = [_delays(settings, parts, i, fit.problem.orders.na, known_nk) for i, fit in enumerate(fits)]
    if settled != delays:
        again, words = at(settled)
        if _mean_square(again) < _mean_square(fits):
            delays, fits, note = settled, again, words
    delay = ", ".join(
        f"{s.name} -> {o.name} {k}"
        for o, nk in zip(parts.train.outputs, delays, strict=True)
        for s, k in zip(parts.train.inputs, nk, strict=True)
    )
    words = note or f"order {fits[0].problem.orders.na}"
    return tuple(fits), f"Fitted to the simulation error: {words}; delays in samples: {delay}."


def _mean_square(fits: Sequence[OneOutput]) -> float:
    """Of the fitting part, per row that counts: a late input leaves fewer of them."""
    return sum(f.cost / sum(len(r.y) - f.problem.start_row() for r in f.problem.usable()) for f in fits)


@once(lambda parts, fits: (_data(parts), tuple((f.problem.orders, f.theta.tobytes()) for f in fits)))
def _refit(parts: Parts, fits: tuple[OneOutput, ...]) -> list[OneOutput]:
    return refit(parts, fits)


def _delays(
    settings: PolynomialSettings, parts: Parts, output: int, probe: int, known_nk: tuple[int, ...] | None
) -> tuple[int, ...]:
    """In samples: as given, as known, or those that a model of order `probe` needs."""
    n_u = len(parts.train.inputs)
    if settings.nk != "auto":
        return as_tuple(settings.nk, n_u)
    if known_nk is not None and n_u > FEW_INPUTS:
        return known_nk
    counts = as_tuple(probe if settings.nb == "auto" else settings.nb, n_u)
    spoken_for = tuple(settings.nk_hint) or (1,) * n_u
    return find_delays(parts.fit, output, replace(_orders(settings, probe, spoken_for), nb=counts))


def _orders(settings: PolynomialSettings, na: int, nk: tuple[int, ...]) -> OutputOrders:
    if settings.nb == "auto":
        nb = tuple(max(na, 1) + (1 if k == 0 else 0) for k in nk)
    else:
        nb = as_tuple(settings.nb, len(nk))
    drift = settings.trend == "estimate"
    return OutputOrders(na, nb, nk, settings.offset and not drift, drift)
