"""Orders of an instrumental variable estimate in a loop, by the response measured through the references.

A free run over a record flown in a loop is ruled by what the loop answers, and prefers models of the
controller. The response that the references show (`frequency.response`) knows nothing of it: of all estimates
the one is taken that describes it with the lowest BIC.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError, FitError
from flysid.model.frequency.response import MeasuredResponse, measure_response
from flysid.model.frequency.simulation_fit import response_bic
from flysid.model.linear.data import Parts
from flysid.model.linear.iv_stages import IVOrders, Path, SignalRoles, driven_by, estimated_by_iv
from flysid.model.linear.settings import PolynomialSettings
from flysid.model.polynomials import ComplexArray
from flysid.model.selection import STRONG
from flysid.model.stream import Blocks, blocks_of


def words_of(orders: Sequence[IVOrders]) -> str:
    """For people; equal orders of several outputs once."""
    return "; ".join(f"na = {o.na}, nb = {o.nb}, nk = {o.nk}" for o in dict.fromkeys(orders))


def orders_by_reference(
    settings: PolynomialSettings, parts: Parts, columns: SignalRoles, nas: Sequence[int]
) -> tuple[list[IVOrders], str] | None:
    """Orders of every output and a sentence about them; None where the references show no response."""
    blocks = blocks_of(parts.whole)
    n_y = len(parts.train.outputs)
    driven = driven_by(blocks, n_y, columns)
    names = [parts.train.inputs[j].name for j in columns.references]
    found = []
    for output in range(n_y):
        try:
            measured = measure_response(parts.whole, output, reference=names)
        except DataError:
            return None
        if any(measured.band(j) is None for j in range(len(columns.inputs))):
            return None
        search = _OrderSearch(parts, blocks, columns, driven, output, measured)
        best = search.best(settings, nas)
        if best is None:
            return None
        found.append(best)
    return found, (f"{words_of(found)}: by BIC on the response measured through {' and '.join(names)}.")


class _OrderSearch:
    """Estimates of one output, each fitted once."""

    def __init__(
        self,
        parts: Parts,
        blocks: Blocks,
        columns: SignalRoles,
        driven: dict[int, Path],
        output: int,
        measured: MeasuredResponse,
    ) -> None:
        self.parts = parts
        self.blocks = blocks
        self.columns = columns
        self.driven = driven
        self.output = output
        self.measured = measured
        self.tried: dict[IVOrders, tuple[bool, float]] = {}

    def best(
        self, settings: PolynomialSettings, nas: Sequence[int], *, longest_delay: int = 10, probe_na: int = 2
    ) -> IVOrders | None:
        """First delays for a probe of low order, then all orders with delays beside those: the lowest order
        against which there is no very strong evidence."""
        probe = min(max(nas), max(probe_na, min(nas)))
        first = [self._orders(settings, probe, k) for k in range(1, longest_delay + 1)]
        start = self._least(first)
        if start is None:
            return None
        nk = start.nk[0]
        near = [k for k in (nk - 1, nk, nk + 1) if k >= 1]
        best = [self._least([self._orders(settings, na, k) for k in near]) for na in sorted(nas)]
        known = [(self._bic(orders), orders) for orders in (*best, start) if orders is not None]
        (explodes, least), _ = min(known, key=lambda k: k[0])
        return next(o for (e, bic), o in known if e == explodes and bic <= least + STRONG)

    def _orders(self, settings: PolynomialSettings, na: int, k: int) -> IVOrders:
        n_u = len(self.columns.inputs)
        nk = (k,) * n_u if settings.nk == "auto" else self.columns.pick(settings.nk)
        nb = (max(na, 1),) * n_u if settings.nb == "auto" else self.columns.pick(settings.nb)
        return IVOrders(na, nb, nk, settings.offset)

    def _least(self, candidates: Sequence[IVOrders]) -> IVOrders | None:
        scored = [(*self._bic(orders), orders) for orders in dict.fromkeys(candidates)]
        scored = [s for s in scored if np.isfinite(s[1])]
        return min(scored, key=lambda s: s[:2])[2] if scored else None

    def _bic(self, orders: IVOrders) -> tuple[bool, float]:
        """Whether it explodes faster than the response tells of, and BIC."""
        if orders not in self.tried:
            try:
                equation = self.output, orders
                theta = estimated_by_iv(self.parts, self.blocks, equation, self.columns, self.driven).theta
            except (FitError, DataError):
                self.tried[orders] = True, np.inf
            else:
                response = _response(orders, theta, self.measured)
                bic = response_bic(self.measured, response, len(theta) - orders.offset)
                self.tried[orders] = self._explodes(orders.polynomials(theta)[0]), bic
        return self.tried[orders]

    def _explodes(self, a: FloatArray) -> bool:
        """A pole to the right of the lowest frequency told: with a delay too long it mimics a lead."""
        lowest = min(band[0] for j in range(len(self.columns.inputs)) if (band := self.measured.band(j)))
        return bool(np.abs(np.roots(a)).max(initial=0.0) > np.exp(lowest * self.measured.dt_s))


def _response(orders: IVOrders, theta: FloatArray, measured: MeasuredResponse) -> ComplexArray:
    """(F, n_u) of the estimate."""
    a, b, _ = orders.polynomials(theta)
    back = np.exp(-1j * measured.omega * measured.dt_s)[:, None]
    bottom = back ** np.arange(len(a)) @ a
    return np.stack([back ** np.arange(len(taps)) @ taps / bottom for taps in b], axis=1)
