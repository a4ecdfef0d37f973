"""IV4: the four-stage instrumental variable estimate of an ARX structure, whatever the colour of the noise.

    A(q) y(k) = B(q) u(k) + c + v(k)        (Ljung, 1999, System Identification, 15.3)

1. least squares; 2. instruments from the simulation of that model; 3. an autoregression L of what is left
over; 4. instruments from the simulation of the second model, everything filtered with L. Consistent where
least squares is biased by coloured noise, without a search. Outputs have an equation each and do not feed
each other.

The instruments must know nothing of the noise. In open loop the inputs are such. In a feedback loop they are
not: name the reference that drives the loop (`reference`), and the instruments are simulated from it alone
(Gilson & Van den Hof, 2005, Automatica 41). Orders and delays are then those whose response is the one
measured through the reference: a free run in a loop follows the noise.

Each stage is a filter and the Gram of lagged signals: three passes over the data in bounded memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.flight_offsets import with_own_constants
from flysid.model.iv_orders import orders_by_reference, words_of
from flysid.model.linear.data import CHOICE_ROWS, Parts, judging_window
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.iv_stages import IVOrders, SignalRoles, fitted_by_iv, scaled_blocks
from flysid.model.linear.oe_search import SHARE
from flysid.model.linear.output_error import HIGHEST_ORDER, ORDER_LOSS, find_delays
from flysid.model.linear.settings import PolynomialSettings
from flysid.model.linear.stability import keep_stable
from flysid.model.selection import block_errors, simplest
from flysid.model.simulation_error import OutputOrders as SearchOrders
from flysid.model.stream import OnDisk, Source, blocks_of
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class IV(PolynomialSettings):
    """Settings of an instrumental variable estimate: those of `PolynomialSettings`, and references.

    Parameters
    ----------
    reference : names of inputs of the dataset that drive a feedback loop from outside. They serve as
        instruments and have no coefficients of their own. Empty: the inputs are their own instruments.

    Source: Söderström & Stoica (1983), Instrumental Variable Methods for System Identification.

    Examples
    --------
    >>> model = flysid.IV(na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> model.dc_gain.round(2)
    array([[2.]])
    """

    reference: Sequence[str] = field(default=(), kw_only=True)

    @on_one_thread
    @with_own_constants
    def fit(self, train: Source, validation: Dataset | None = None) -> FittedLinear:
        """Choose delays and orders (on the first 200,000 samples of a dataset on disk), fit.

        Raises
        ------
        UsageError : settings that cannot be.
        DataError : no or too few samples, a signal that never changes.
        FitError : the instruments say nothing about the output.
        """
        self.check(train)
        columns = _columns(self, train)
        if isinstance(train, OnDisk):
            small = train.head(CHOICE_ROWS)
        else:
            train, validation = self.detrended(train, validation)
            small = train
        orders, note = _chosen(self, Parts.of(small, validation, centred=self.offset), columns)
        parts = Parts.measured(train, centred=self.offset)
        scale = parts.scaling
        blocks = scaled_blocks(
            blocks_of(train, np.concatenate([scale.y_origin, scale.u_origin])),
            np.concatenate([scale.y_scale, scale.u_scale]),
        )
        model = replace(fitted_by_iv(parts, blocks, orders, columns, self.n_init), notes=(note,))
        return keep_stable(model, small, stable=self.stable)


def _columns(settings: IV, data: Source) -> SignalRoles:
    names = [s.name for s in data.inputs]
    for name in settings.reference:
        if name not in names:
            raise UsageError(f"no input is called {name!r}", hint=f"one of {', '.join(names)}")
    references = tuple(i for i, name in enumerate(names) if name in settings.reference)
    inputs = tuple(i for i in range(len(names)) if i not in references)
    if not inputs:
        raise UsageError(
            "every input is a reference: none is left for the model",
            hint="name as references what drives the loop, not what enters the plant",
        )
    return SignalRoles(inputs, references)


def _chosen(settings: IV, parts: Parts, columns: SignalRoles) -> tuple[list[IVOrders], str]:
    """Orders of every output: with references by the response measured through them, else delays by the
    simulation error and the order by the validation free run."""
    n_u = len(columns.inputs)
    n_y = len(parts.train.outputs)
    most = max(1, min(HIGHEST_ORDER, (len(parts.fit) // SHARE - 1) // (1 + n_u)))
    nas = range(1, most + 1) if settings.na == "auto" else [int(settings.na)]
    if len(columns.references) >= n_u and "auto" in (settings.na, settings.nb, settings.nk):
        known = orders_by_reference(settings, parts, columns, nas)
        if known is not None:
            return known
    delays = [_delays(settings, parts, columns, i, min(2, max(nas))) for i in range(n_y)]
    candidates = [[_orders(settings, na, nk, columns) for nk in delays] for na in nas]
    if len(candidates) == 1:
        return candidates[0], f"Orders: {words_of(candidates[0])}."
    skip = judging_window(parts, max(o.depth for orders in candidates for o in orders))
    tried: list[tuple[list[IVOrders], FloatArray]] = []
    for orders in candidates:
        try:
            model = fitted_by_iv(parts, blocks_of(parts.fit), orders, columns, skip)
        except (FitError, DataError):
            continue
        if model.is_stable:
            tried.append((orders, block_errors(model, parts.check, skip, parts.scaling.y_scale)))
    if not tried:
        return candidates[0], f"Orders: {words_of(candidates[0])}, because no estimate was stable."
    index = simplest([errors for _, errors in tried], ORDER_LOSS)
    table = ", ".join(f"order {o[0].na}: {np.sqrt(e.mean()) if len(e) else np.nan:.3g}" for o, e in tried)
    return tried[index][0], (
        f"{words_of(tried[index][0])}: the simplest within one standard error of the best validation"
        f" free run (RMSE in standard deviations of the output: {table})."
    )


def _delays(settings: IV, parts: Parts, columns: SignalRoles, output: int, probe: int) -> tuple[int, ...]:
    if settings.nk != "auto":
        return columns.pick(settings.nk)
    counts = columns.pick(probe if settings.nb == "auto" else settings.nb)
    kept = list(columns.inputs)
    data = replace(
        parts.fit,
        inputs=tuple(parts.fit.inputs[j] for j in kept),
        segments=tuple(replace(s, u=s.u[:, kept]) for s in parts.fit.segments),
    )
    spoken_for = columns.pick(settings.nk_hint) if settings.nk_hint else (1,) * len(kept)
    return find_delays(data, output, SearchOrders(probe, counts, spoken_for, settings.offset))


def _orders(settings: IV, na: int, nk: tuple[int, ...], columns: SignalRoles) -> IVOrders:
    if settings.nb == "auto":
        nb = tuple(max(na, 1) + (1 if k == 0 else 0) for k in nk)
    else:
        nb = columns.pick(settings.nb)
    return IVOrders(na, nb, nk, settings.offset)
