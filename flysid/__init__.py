"""flysid: flight logs in, trustworthy models out.

The public names are imported on first use, so that `import flysid` costs next to nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from flysid.version import __version__

_HOME = {
    "ARX": "flysid.model.arx",
    "OE": "flysid.model.oe",
    "ARMAX": "flysid.model.armax",
    "BJ": "flysid.model.bj",
    "FIR": "flysid.model.fir",
    "IV": "flysid.model.iv",
    "StateSpace": "flysid.model.statespace",
    "StructuredStateSpace": "flysid.model.structured.structured_state_space",
    "TF": "flysid.model.transfer_function",
    "Multirotor": "flysid.model.multirotor",
    "PolyNARX": "flysid.model.polynarx",
    "Line": "flysid.model.line",
    "Mean": "flysid.model.mean",
    "Persistence": "flysid.model.persistence",
    "TS": "flysid.model.ts",
    "TSStateSpace": "flysid.model.ts_state_space",
    "BestTS": "flysid.model.ts_best",
    "StaticTS": "flysid.model.static_ts",
    "ANFIS": "flysid.model.anfis",
    "Ensemble": "flysid.model.ensemble",
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
    "draw_rules": "flysid.validate.rulesfigure",
    "update": "flysid.model.rules.update",
    "with_stable_rules": "flysid.model.rules.stabilise",
    "refit_consequents": "flysid.model.rules.consequents",
    "SearchSettings": "flysid.model.rules.search_settings",
}

__all__ = [  # noqa: RUF022
    "__version__",
    "ARX",
    "OE",
    "ARMAX",
    "BJ",
    "FIR",
    "IV",
    "StateSpace",
    "StructuredStateSpace",
    "TF",
    "Multirotor",
    "PolyNARX",
    "Line",
    "Mean",
    "Persistence",
    "TS",
    "TSStateSpace",
    "BestTS",
    "StaticTS",
    "ANFIS",
    "Ensemble",
    "Dataset",
    "Segment",
    "Signal",
    "Flight",
    "Damage",
    "FlysidError",
    "FormatError",
    "UsageError",
    "RecipeError",
    "DataError",
    "StoreError",
    "FitError",
    "read",
    "open",
    "dataset_from",
    "load",
    "compare",
    "measure_response",
    "draw_rules",
    "update",
    "with_stable_rules",
    "refit_consequents",
    "SearchSettings",
]

if TYPE_CHECKING:
    from flysid.dataset import Dataset, Segment, Signal
    from flysid.errors import (
        DataError,
        FitError,
        FlysidError,
        FormatError,
        RecipeError,
        StoreError,
        UsageError,
    )
    from flysid.flight import Damage, Flight
    from flysid.ingest.align.quick import dataset_from
    from flysid.ingest.formats.registry import read
    from flysid.ingest.lake.lake import open  # noqa: A004
    from flysid.model.anfis import ANFIS
    from flysid.model.armax import ARMAX
    from flysid.model.arx import ARX
    from flysid.model.base import load
    from flysid.model.bj import BJ
    from flysid.model.ensemble import Ensemble
    from flysid.model.fir import FIR
    from flysid.model.frequency.response import measure_response
    from flysid.model.iv import IV
    from flysid.model.line import Line
    from flysid.model.mean import Mean
    from flysid.model.multirotor import Multirotor
    from flysid.model.oe import OE
    from flysid.model.persistence import Persistence
    from flysid.model.polynarx import PolyNARX
    from flysid.model.rules.consequents import refit_consequents
    from flysid.model.rules.search_settings import SearchSettings
    from flysid.model.rules.stabilise import with_stable_rules
    from flysid.model.rules.update import update
    from flysid.model.statespace import StateSpace
    from flysid.model.static_ts import StaticTS
    from flysid.model.structured.structured_state_space import StructuredStateSpace
    from flysid.model.transfer_function import TF
    from flysid.model.ts import TS
    from flysid.model.ts_best import BestTS
    from flysid.model.ts_state_space import TSStateSpace
    from flysid.validate.compare_models import compare
    from flysid.validate.rulesfigure import draw_rules


def __getattr__(name: str) -> Any:
    try:
        home = _HOME[name]
    except KeyError:
        raise AttributeError(f"module 'flysid' has no attribute {name!r}") from None
    value = getattr(importlib.import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
