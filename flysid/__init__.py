"""flysid: flight logs in, trustworthy models out.

The public names are imported on first use, so that `import flysid` costs next to nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from flysid.version import __version__ as __version__

_HOME = {
    "Dataset": "flysid.dataset",
    "Segment": "flysid.dataset",
    "Signal": "flysid.dataset",
    "Flight": "flysid.flight",
    "Damage": "flysid.flight",
    "FlysidError": "flysid.errors",
    "FormatError": "flysid.errors",
    "UsageError": "flysid.errors",
    "RecipeError": "flysid.errors",
    "DataError": "flysid.errors",
    "StoreError": "flysid.errors",
    "FitError": "flysid.errors",
    "read": "flysid.ingest.formats.registry",
    "open": "flysid.ingest.lake.lake",
    "dataset_from": "flysid.ingest.align.quick",
    "load": "flysid.model.base",
    "compare": "flysid.validate.compare_models",
    "measure_response": "flysid.model.frequency.response",
    "draw_rules": "flysid.validate.show.rulesfigure",
    "update": "flysid.model.rules.update",
    "with_stable_rules": "flysid.model.rules.stabilise",
    "refit_consequents": "flysid.model.rules.consequents",
    "SearchSettings": "flysid.model.rules.search_settings",
    "BestTS": "flysid.model.ts_best",
    "review": "flysid.reviews.review",
    "Vehicle": "flysid.sixdof.vehicle",
    "load_vehicle": "flysid.sixdof.fitted",
}
"""Public names beside those of the model structures, which are the rows of `flysid.model.structures`."""

if TYPE_CHECKING:
    from flysid.dataset import Dataset as Dataset
    from flysid.dataset import Segment as Segment
    from flysid.dataset import Signal as Signal
    from flysid.errors import DataError as DataError
    from flysid.errors import FitError as FitError
    from flysid.errors import FlysidError as FlysidError
    from flysid.errors import FormatError as FormatError
    from flysid.errors import RecipeError as RecipeError
    from flysid.errors import StoreError as StoreError
    from flysid.errors import UsageError as UsageError
    from flysid.flight import Damage as Damage
    from flysid.flight import Flight as Flight
    from flysid.ingest.align.quick import dataset_from as dataset_from
    from flysid.ingest.formats.registry import read as read
    from flysid.ingest.lake.lake import open as open  # noqa: A004
    from flysid.model.anfis import ANFIS as ANFIS
    from flysid.model.armax import ARMAX as ARMAX
    from flysid.model.arx import ARX as ARX
    from flysid.model.base import load as load
    from flysid.model.bj import BJ as BJ
    from flysid.model.ensemble import Ensemble as Ensemble
    from flysid.model.fir import FIR as FIR
    from flysid.model.frequency.response import measure_response as measure_response
    from flysid.model.iv import IV as IV
    from flysid.model.line import Line as Line
    from flysid.model.mean import Mean as Mean
    from flysid.model.multirotor import Multirotor as Multirotor
    from flysid.model.oe import OE as OE
    from flysid.model.persistence import Persistence as Persistence
    from flysid.model.polynarx import PolyNARX as PolyNARX
    from flysid.model.rules.consequents import refit_consequents as refit_consequents
    from flysid.model.rules.search_settings import SearchSettings as SearchSettings
    from flysid.model.rules.stabilise import with_stable_rules as with_stable_rules
    from flysid.model.rules.update import update as update
    from flysid.model.statespace import StateSpace as StateSpace
    from flysid.model.static_ts import StaticTS as StaticTS
    from flysid.model.structured.structured_state_space import StructuredStateSpace as StructuredStateSpace
    from flysid.model.transfer_function import TF as TF
    from flysid.model.ts import TS as TS
    from flysid.model.ts_best import BestTS as BestTS
    from flysid.model.ts_state_space import TSStateSpace as TSStateSpace
    from flysid.reviews.review import review as review
    from flysid.sixdof.fitted import load_vehicle as load_vehicle
    from flysid.sixdof.vehicle import Vehicle as Vehicle
    from flysid.validate.compare_models import compare as compare
    from flysid.validate.show.rulesfigure import draw_rules as draw_rules


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return ["__version__", *_homes()]
    home = _HOME.get(name) or _homes().get(name)
    if home is None:
        raise AttributeError(f"module 'flysid' has no attribute {name!r}")
    value = getattr(importlib.import_module(home), name)
    globals()[name] = value
    return value


def _homes() -> dict[str, str]:
    """Module of every public name; the table of structures is read when a name is first needed."""
    from flysid.model.structures import public_names

    return {**public_names(), **_HOME}


def __dir__() -> list[str]:
    return ["__version__", *sorted(_homes())]
