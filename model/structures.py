"""The table of model structures: a row holds all that flysid knows of a structure beside its module.

The command line, the shell's completion, the fit, the comparison, the page, the export and the studio read
rows and name no structure. A row points at code by "module:name", which is imported when it is first needed:
to read the table costs nothing.

A new structure of flysid is its module and its row here. Another package adds one with an entry point of the
group "flysid.structures" that names a `Structure`:

    [project.entry-points."flysid.structures"]
    mystructure = "mypackage.table:ROW"
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from flysid.model.structure import SETTINGS, Kind, Structure
from flysid.offers import Offer, offers

__all__ = [
    "ENTRY_POINTS", "OWN", "SETTINGS", "Structure", "all_structures", "kind_of", "leaders", "least",
    "public_names", "references", "row_of", "table",
]  # fmt: skip

ENTRY_POINTS = "flysid.structures"


def _linear(name: str, estimator: str, **more: Any) -> Structure:
    """A difference equation; `estimator` without the package."""
    usual = {
        "estimator": f"flysid.model.{estimator}",
        "rebuild": "flysid.model.linear.difference_equation:from_dict",
        "kind": "linear",
        "program": "flysid.export.from_linear:linear_program",
        "pieces": "flysid.model.in_pieces:equation_in_pieces",
    }
    return Structure(name, **usual | more)


def _states(name: str, **more: Any) -> Structure:
    """A state space."""
    return Structure(
        name,
        kind="linear",
        program="flysid.export.from_linear:state_space_program",
        pieces="flysid.model.in_pieces:states_in_pieces",
        **more,
    )


_STORED_RULES: Mapping[str, Any] = {
    "rebuild": "flysid.model.rules.fitted:from_dict",
    "program": "flysid.export.from_rules:program_of_rules",
    "pieces": "flysid.model.in_pieces:rules_in_pieces",
}
_SEARCH = ("antecedents", "flight_offsets", "nk_hint", "rules", "search")

OWN: Mapping[str, Structure] = {
    row.name: row
    for row in (
        _linear(
            "mean",
            "mean:Mean",
            kind="reference",
            gate="nothing",
            fitted="always",
            streams=True,
            has_memory=False,
            cost=0.0,
            words="mean of the training data",
            least="the training mean",
            title="Mean",
        ),
        _linear(
            "persistence",
            "persistence:Persistence",
            kind="reference",
            gate="nothing",
            fitted="always",
            streams=True,
            has_memory=False,
            cost=0.0,
            words="starting value, held",
            least="the held starting value",
            title="Last value",
        ),
        _linear(
            "line",
            "line:Line",
            fitted="usually",
            has_memory=False,
            cost=0.0,
            words="straight line",
            least="a static line",
            title="Straight line",
        ),
        _linear(
            "arx",
            "arx:ARX",
            takes=("flight_offsets", "nk_hint"),
            fitted="always",
            competes=True,
            streams=True,
            words="linear model",
            title="ARX model",
        ),
        _linear(
            "oe",
            "oe:OE",
            takes=("flight_offsets", "nk_hint"),
            fitted="always",
            competes=True,
            words="output-error model",
            title="Output-error model",
        ),
        _linear(
            "armax",
            "armax:ARMAX",
            takes=("flight_offsets", "nk_hint"),
            competes=True,
            words="ARMAX model",
            title="ARMAX model (its free run)",
        ),
        _linear(
            "bj",
            "bj:BJ",
            takes=("flight_offsets", "nk_hint"),
            competes=True,
            words="Box-Jenkins model",
            title="Box-Jenkins model (its free run)",
        ),
        _states(
            "statespace",
            estimator="flysid.model.statespace:StateSpace",
            rebuild="flysid.model.subspace.fitted_model:from_dict",
            takes=("flight_offsets", "nk_hint"),
            competes=True,
            streams=True,
            words="state-space model",
            title="State-space model",
        ),
        Structure(
            "linear_lags",
            build="flysid.model.one_rule:over_lags",
            takes=("flight_offsets", "nk_hint", "nk_least", "search"),
            kind="linear",
            competes=True,
            words="linear model over lags",
        ),
        Structure(
            "linear_ss",
            build="flysid.model.one_rule:over_states",
            takes=("flight_offsets", "nk_hint", "search"),
            kind="linear",
            competes=True,
            words="linear state-space model",
        ),
        _linear("fir", "fir:FIR", streams=True, title="Finite impulse response"),
        _linear(
            "iv",
            "iv:IV",
            takes=("flight_offsets", "nk_hint"),
            streams=True,
            title="Instrumental-variable model",
        ),
        _linear(
            "tf",
            "transfer_function:TF",
            rebuild="flysid.model.transfer_function:from_dict",
            takes=("nk_hint",),
            title="Transfer function, sampled",
        ),
        Structure(
            "multirotor",
            "flysid.model.multirotor:from_dict",
            estimator="flysid.model.multirotor:Multirotor",
            kind="physics",
            gate="held value",
            words="physical model",
            program="flysid.export.from_physics:multirotor_program",
        ),
        _states(
            "structured",
            estimator="flysid.model.structured.structured_state_space:StructuredStateSpace",
            rebuild="flysid.model.structured.fitted_structured:from_dict",
            takes=("file",),
            gate="held value",
            words="structured model",
            title="Structured state space",
        ),
        Structure(
            "polynarx",
            "flysid.model.narx.fitted_polynomial:from_dict",
            estimator="flysid.model.polynarx:PolyNARX",
            takes=("flight_offsets", "nk_hint"),
            fitted="usually",
            cost=2.0,
            words="polynomial NARX model",
            program="flysid.export.from_terms:polynomial_program",
        ),
        Structure(
            "static_ts",
            "flysid.model.static_ts:from_dict",
            stored="static-ts",
            estimator="flysid.model.static_ts:StaticTS",
            takes=("seed",),
            kind="rules",
            fitted="usually",
            has_memory=False,
            cost=0.0,
            words="static fuzzy model",
            program="flysid.export.from_rules:static_program",
            pieces="flysid.model.in_pieces:from_the_newest",
        ),
        Structure(
            "ts",
            estimator="flysid.model.ts:TS",
            takes=(*_SEARCH, "nk_least"),
            kind="rules",
            fitted="usually",
            leads=True,
            cost=10.0,
            words="fuzzy model",
            **_STORED_RULES,
        ),
        Structure(
            "ts_lags",
            build="flysid.model.ts:of_lags",
            takes=(*_SEARCH, "nk_least"),
            kind="rules",
            leads=True,
            cost=10.0,
            words="fuzzy model over lags",
        ),
        Structure(
            "ts_ss",
            estimator="flysid.model.ts_state_space:TSStateSpace",
            takes=_SEARCH,
            kind="rules",
            leads=True,
            cost=10.0,
            words="fuzzy state-space model",
            **_STORED_RULES,
        ),
        Structure(
            "anfis",
            estimator="flysid.model.anfis:ANFIS",
            build="flysid.model.anfis:of_run",
            takes=("antecedents", "nk_hint", "rules"),
            kind="rules",
            words="ANFIS model",
        ),
        Structure(
            "ensemble",
            "flysid.model.ensemble:from_dict",
            estimator="flysid.model.ensemble:Ensemble",
            build="flysid.model.ensemble:of_rules",
            takes=(*_SEARCH, "nk_least"),
            cost=50.0,
            words="ensemble of fuzzy models",
            pieces="flysid.model.in_pieces:members_in_pieces",
        ),
    )
}
"""flysid's own rows, by name, in the order in which a run fits them."""


@cache
def table() -> Mapping[str, Structure]:
    """Every row by its name: flysid's own, then those of installed packages.

    Raises
    ------
    UsageError : an installed package offers what is no row, or a name that is taken.
    """
    rows = dict(OWN)
    taken = {name for row in OWN.values() for name in (row.name, row.file_name)}
    for offer in offers(ENTRY_POINTS):
        row = _offered(offer)
        for name in {row.name, row.file_name}:
            if name in taken:
                raise offer.refusal(f"the name {name!r} is taken")
            taken.add(name)
        rows[row.name] = row
    return rows


def _offered(offer: Offer) -> Structure:
    """The row that an entry point names; of a function, a row of models that are read and not fitted."""
    offered = offer.load()
    if callable(offered):
        return Structure(offer.name, offer.value, package=offer.package)
    if not isinstance(offered, Structure):
        raise offer.refusal("it is neither a flysid.model.structures.Structure nor a function")
    if why := _fault(offered):
        raise offer.refusal(why)
    return replace(offered, package=offer.package)


def _fault(row: Structure) -> str:
    """What keeps a row of another package from the table; "" where nothing does."""
    if not re.fullmatch(r"[a-z0-9][a-z0-9_-]*", row.name):
        return f"the name {row.name!r} must be of small letters, digits, _ and -"
    if not (row.rebuild or row.can_be_fitted):
        return "it says neither how models are fitted nor how they are rebuilt"
    if row.competes or row.fitted != "on request":
        return "a run must not depend on what is installed: fitted='on request' and competes=False"
    unknown = [name for name in row.takes if name not in SETTINGS]
    return f"takes={unknown[0]!r} is not one of {', '.join(SETTINGS)}" if unknown else ""


@cache
def all_structures() -> Mapping[str, Structure]:
    """The row of every structure by what model files call it; errors as `table`."""
    return {row.file_name: row for row in table().values() if row.rebuild}


def kind_of(structure: str) -> Kind:
    """What a structure is to a comparison; "other" where nothing is known of it."""
    row = all_structures().get(structure)
    return row.kind if row else "other"


def row_of(name: str) -> Structure:
    """The row of this name, or of the structure that model files call so; an empty one of an unknown name."""
    return table().get(name) or all_structures().get(name) or Structure(name)


def leaders() -> tuple[str, ...]:
    """Names that the headline speaks of; the first that was fitted wins."""
    return tuple(name for name, row in table().items() if row.leads)


def references() -> tuple[str, ...]:
    """Names of what no verdict is about: a model that loses to them has learnt nothing."""
    return tuple(name for name, row in table().items() if row.kind == "reference")


def least() -> tuple[Structure, ...]:
    """Rows that a model with memory has to beat to have learnt anything, the weakest first."""
    return tuple(row for row in table().values() if row.least)


def public_names() -> Mapping[str, str]:
    """Name in the package `flysid` -> module, of the settings of flysid's own structures."""
    paths = (row.estimator.partition(":") for row in OWN.values() if row.estimator)
    return {name: module for module, _, name in paths}
