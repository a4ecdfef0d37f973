"""Polynomial NARX: an output as a sum of terms that can be named, found by the free run.

    y(k) = sum_t theta_t phi_t,    phi_t a product of past outputs, inputs, their changes, magnitudes, signs

(Leontaritis & Billings, 1985, Int. J. Control 41). The search starts from linear models and adds one term at
a time, by what the free run gains (Piroddi & Spinelli, 2003, Int. J. Control 76); all coefficients are then
refined on the simulation error. `narx/term_search` tells how, `notes` what was added and why.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from flysid.dataset import Dataset
from flysid.errors import DataError, FitError
from flysid.model.arx import ARX
from flysid.model.flight_offsets import with_own_constants
from flysid.model.last_gates import LINEAR_ENOUGH, shortfall
from flysid.model.linear.data import Parts
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.settings import Auto
from flysid.model.narx.fitted_polynomial import FittedPolyNARX, Units
from flysid.model.narx.polynomial_terms import depth_of
from flysid.model.narx.term_search import RefinedTerms, TermSearch, finish, grown, linear_terms, proven, prune
from flysid.model.own_constants import FlightOffsets
from flysid.model.selection import clearly_better
from flysid.model.settings import Settings
from flysid.model.shared import fit_key, once
from flysid.model.threads import on_one_thread
from flysid.showing import counted

STRAIGHT_ON = "Where signals leave the range of training, nonlinear terms go on along their tangents."
LAGS = 2
"""Of the smallest plant that has a speed of its own: a mass, a spring and a damper."""


@dataclass(frozen=True)
class PolyNARX(Settings):
    """Settings of a polynomial NARX model.

    Parameters
    ----------
    na, nb, nk : orders and delays of the linear model that terms are added to, as of `ARX`. Where all are
        "auto", the search starts from what `ARX` chooses, and from two lags with delays of their own and with
        none, and takes the one whose polynomial is clearly better on held-out blocks. Where no term helps,
        what `ARX` chooses comes out, parameter for parameter, and its first note says so.
    most_terms : nonlinear terms at most.
    nk_hint : delays that "auto" tries besides its own, one per input.
    flight_offsets : a constant of every flight beside the model, see `flysid.model.flight_offsets`: "auto"
        where flights differ beyond chance, True or False to force.

    Source: Leontaritis & Billings (1985); Piroddi & Spinelli (2003), selection by the simulation error.

    Examples
    --------
    >>> model = flysid.PolyNARX(na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> model.structure  # the plant of `train` is linear
    'arx'
    """

    na: int | Auto = "auto"
    nb: int | Sequence[int] | Auto = "auto"
    nk: int | Sequence[int] | Auto = "auto"
    most_terms: int = 10
    nk_hint: Sequence[int] = ()
    flight_offsets: FlightOffsets = "auto"

    @on_one_thread
    @once(fit_key)
    @with_own_constants
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedPolyNARX | FittedLinear:
        """Start from linear models, add terms, leave out those that say nothing, refine.

        Raises
        ------
        UsageError : settings that cannot be. DataError : no or too few samples, a signal that never changes.
        FitError : no linear model to start from, or no segment three times as long as its deepest lag.
        """
        bases = list(self._linear(train, validation))
        parts = Parts.of(train, validation)
        units = Units.of(train)
        starts = dict(linear_terms(model, units) for model in bases)
        depth = max(map(depth_of, starts))
        searches = [TermSearch(parts, units, terms, theta, depth) for terms, theta in starts.items()]
        if parts.check is parts.fitted:
            return _linear_alone(bases[0], "no part of the data is held out that could judge terms.")
        found = [found for search in searches if (found := self._search(search)) is not None]
        if not found:
            why = "the linear model's free run leaves its limits, or there are too few held-out samples."
            return _linear_alone(bases[0], why)
        best = found[0]
        for other in found[1:]:
            if clearly_better(other.chosen.errors, best.chosen.errors):
                best = other
        others = sorted((f for f in found if f is not best), key=lambda f: float(f.chosen.errors.mean()))
        for one in (best, *others):
            if all(term.is_linear for term in one.chosen.terms):
                return _linear_alone(bases[0], "no term helps on held-out data.", one.notes)
            model = finish(one.search, one.chosen)
            if model is None:
                continue
            model = model.held_to(train)
            if not shortfall(model, {"ARX": bases[0]}, train, 0.0):
                return replace(model, notes=(*one.notes, *model.meanings(), STRAIGHT_ON))
        why = "no model with nonlinear terms is better both on held-out data and over all training data."
        return _linear_alone(bases[0], why, best.notes)

    def _linear(self, train: Dataset, validation: Dataset | None) -> Iterator[FittedLinear]:
        """What terms are added to."""
        settings: dict[str, Any] = {"na": self.na, "nb": self.nb, "nk": self.nk, "nk_hint": self.nk_hint}
        yield ARX(**settings).fit(train, validation)
        if (self.na, self.nb, self.nk) == ("auto", "auto", "auto"):
            for nk in ("auto", 1):
                try:
                    yield ARX(**{**settings, "na": LAGS, "nb": LAGS, "nk": nk}).fit(train, validation)
                except (DataError, FitError):
                    continue

    def _search(self, search: TermSearch) -> _Found | None:
        notes: list[str] = []
        first = search.first()
        if first is None:
            return None
        notes.append(
            f"Linear start of {counted(len(first.terms), 'term')}: held-out free-run RMSE {first.rmse}."
        )
        chosen = proven(search, prune(search, grown(search, first, self.most_terms, notes), notes), notes)
        return _Found(search, chosen, tuple(notes))


def _linear_alone(model: FittedLinear, why: str, notes: Sequence[str] = ()) -> FittedLinear:
    """The linear model itself: as terms it would start otherwise, and be held at its limits on the way."""
    return replace(model, notes=(f"{LINEAR_ENOUGH}{why}", *notes, *model.notes))


@dataclass(frozen=True, eq=False)
class _Found:
    """Where a search ended, and the way."""

    search: TermSearch
    chosen: RefinedTerms
    notes: tuple[str, ...]
