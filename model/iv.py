"""IV4: the four-stage instrumental variable estimate of an ARX structure, whatever the colour of the noise.

    A(q) y(k) = B(q) u(k) + c + v(k)        (Ljung, 1999, System Identification, 15.3)

1. least squares; 2. instruments from the simulation of that model, and again from its own until they settle;
3. an autoregression L of what is left over; 4. instruments from the simulation of the second model,
everything filtered with L. Consistent where least squares is biased by coloured noise, without a search.
Outputs have an equation each and do not feed each other.

The instruments must know nothing of the noise. In open loop the inputs are such. In a feedback loop they are
not: name the reference that drives the loop (`reference`), and the instruments are simulated from it alone
(Gilson & Van den Hof, 2005, Automatica 41). Orders and delays are then those whose response is the one
measured through the reference: a free run in a loop follows the noise.

Each stage is a filter and the Gram of lagged signals: three to six passes over the data in bounded memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.flight_offsets import with_own_constants
from flysid.model.iv_orders import orders_by_reference, words_of
from flysid.model.last_gates import refuse
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

Chosen: TypeAlias = tuple[list[IVOrders], str]
"""Orders of every output, and why."""
Tried: TypeAlias = tuple[list[IVOrders], FloatArray]
"""Orders of every output, and block errors of their estimate."""


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

        Without references, orders whose free run loses the training data give way to the next best: the first
        value held must follow them no better. In a feedback loop a free run follows the noise and says
        nothing.

        Raises
        ------
        UsageError : settings that cannot be.
        DataError : no or too few samples, a signal that never changes.
        FitError : the instruments say nothing about the output; every model loses its own training data.
        """
        self.check(train)
        columns = _columns(self, train)
        if isinstance(train, OnDisk):
            small = train.head(CHOICE_ROWS)
        else:
            train, validation = self.detrended(train, validation)
            small = train
        ranked = _ranked(self, Parts.of(small, validation, centred=self.offset), columns)
        parts = Parts.measured(train, centred=self.offset)
        scale = parts.scaling
        blocks = scaled_blocks(
            blocks_of(train, np.concatenate([scale.y_origin, scale.u_origin])),
            np.concatenate([scale.y_scale, scale.u_scale]),
        )

        def fitted(chosen: Chosen) -> FittedLinear:
            orders, note = chosen
            return replace(fitted_by_iv(parts, blocks, orders, columns, self.n_init), notes=(note,))

        model = fitted(ranked[0]) if self.reference else _first_to_follow(fitted, ranked, small)
        return keep_stable(model, small, stable=self.stable)


def _first_to_follow(
    fitted: Callable[[Chosen], FittedLinear], ranked: Sequence[Chosen], train: Dataset
) -> FittedLinear:
    """The first stable model whose free run follows the data at least as the first value held does.

    Of an integrating plant every estimate may lie outside the unit circle by a hair: where no stable one
    follows, the first that does. Raises FitError: none does.
    """
    loose: list[FittedLinear] = []
    why: list[FitError] = []
    for chosen in ranked:
        try:
            model = refuse(fitted(chosen), {}, train)
        except FitError as error:
            why.append(error)
            continue
        if model.is_stable:
            return model
        loose.append(model)
    if not loose:
        raise why[0]
    return loose[0]


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


def _ranked(settings: IV, parts: Parts, columns: SignalRoles) -> list[Chosen]:
    """Orders of every output, the best first: with references by the response measured through them alone,
    else delays by the simulation error and the order by the validation free run."""
    n_u = len(columns.inputs)
    n_y = len(parts.train.outputs)
    most = max(1, min(HIGHEST_ORDER, (len(parts.fit) // SHARE - 1) // (1 + n_u)))
    nas = range(1, most + 1) if settings.na == "auto" else [int(settings.na)]
    if len(columns.references) >= n_u and "auto" in (settings.na, settings.nb, settings.nk):
        known = orders_by_reference(settings, parts, columns, nas)
        if known is not None:
            return [known]
    delays = [_delays(settings, parts, columns, i, min(2, max(nas))) for i in range(n_y)]
    first = _Trial.of(settings, parts, columns, nas, delays)
    # what a model of two lags takes for dead time may be a third lag
    settled = [_delays(settings, parts, columns, i, max(o.na, 1)) for i, o in enumerate(first.chosen)]
    if settled == delays:
        return first.ranked()
    again = _Trial.of(settings, parts, columns, nas, settled)
    return (again if again.error < first.error else first).ranked()


@dataclass(frozen=True, eq=False)
class _Trial:
    """Estimates of several orders with the same delays.

    `tried`: orders by their order and block errors on the checking part; those whose estimate is stable.
    `unstable`: the others with an estimate.
    `least`: orders of the lowest order, where there is no estimate at all.
    """

    tried: list[Tried]
    unstable: list[Tried]
    least: list[IVOrders]

    @classmethod
    def of(
        cls,
        settings: IV,
        parts: Parts,
        columns: SignalRoles,
        nas: Sequence[int],
        delays: Sequence[tuple[int, ...]],
    ) -> _Trial:
        """Fit every order."""
        candidates = [[_orders(settings, na, nk, columns) for nk in delays] for na in nas]
        skip = judging_window(parts, max(o.depth for orders in candidates for o in orders))
        tried: dict[bool, list[Tried]] = {True: [], False: []}
        for orders in candidates:
            try:
                model = fitted_by_iv(parts, blocks_of(parts.fit), orders, columns, skip)
            except (FitError, DataError):
                continue
            errors = block_errors(model, parts.check, skip, parts.scaling.y_scale)
            tried[model.is_stable].append((orders, errors))
        return cls(tried[True], tried[False], candidates[0])

    @cached_property
    def index(self) -> int:
        """Of the simplest within one standard error of the best."""
        return simplest([errors for _, errors in self.tried], ORDER_LOSS)

    @property
    def chosen(self) -> list[IVOrders]:
        """Orders of every output."""
        return self.tried[self.index][0] if self.tried else self.least

    @property
    def error(self) -> float:
        """Mean square of the chosen orders on the checking part; inf where no estimate was stable."""
        return _mean(self.tried[self.index]) if self.tried else np.inf

    def ranked(self) -> list[Chosen]:
        """Orders with the reason for them: the chosen, then the other stable ones and the rest by error."""
        table = ", ".join(f"order {each[0][0].na}: {np.sqrt(_mean(each)):.3g}" for each in self.tried)
        measured = f"validation free run (RMSE in standard deviations of the output: {table})."
        whole = f"{words_of(self.chosen)}: the simplest within one standard error of the best {measured}"
        alone = f"Orders: {words_of(self.chosen)}{'' if self.tried else ', because no estimate was stable'}."
        rest = [each[0] for group in (self.tried, self.unstable) for each in sorted(group, key=_mean)]
        return [
            (self.chosen, whole if len(self.tried) > 1 else alone),
            *(
                (orders, f"{words_of(orders)}: estimates of likelier orders lost the training data.")
                for orders in rest
                if orders is not self.chosen
            ),
        ]


def _mean(tried: Tried) -> float:
    return float(tried[1].mean()) if len(tried[1]) else np.inf


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
