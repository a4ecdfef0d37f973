"""The fields that a comparison's document will have, known before anything is compared.

`--fail-if` is tried on this document first: a misspelt field costs a second then, and not the whole report.
Values are of the right type and mean nothing. The fields come from the code that writes the real document, so
they cannot drift from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from flysid.dataset import Signal
from flysid.model.base import Fitted
from flysid.validate.compare.comparison import Entry, ModelScore, Pair
from flysid.validate.compare.intervals import ErrorChange, Scope
from flysid.validate.compare.metrics import Scores
from flysid.validate.compare.models import HORIZONS, Sides, sides_of
from flysid.validate.compare.trials import FREE_RUN, horizon_name
from flysid.validate.compare.verdict import Evidence, Verdict
from flysid.validate.diagnose.document import channel_documents
from flysid.validate.runs.run import Beside, Run, models_of, requested_model

SCORE = ModelScore(Scores(1, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0), ())


def expected_of_run(run: Run, beside: Beside = MappingProxyType({})) -> dict[str, Any]:
    """The fields of what `judge_run` will find; arguments as there.

    Raises StoreError: a model file is damaged.
    """
    channels = {}
    for channel in run.channels:
        models = {**models_of(run, channel), **beside.get(channel.name, {})}
        contender = requested_model(run.settings.models, models, channel.baseline)
        channels[channel.name] = models, sides_of(models, channel.baseline, contender)
    return expected_document(channels, run.skipped)


def expected_document(
    channels: Mapping[str, tuple[Mapping[str, Fitted], Sides]], skipped: Mapping[str, str]
) -> dict[str, Any]:
    """{"channels": ..., "skipped": ...} as in the real document, of models by channel and who meets whom."""
    found: dict[str, Any] = {}
    for name, (models, sides) in channels.items():
        outputs = next(iter(models.values())).outputs
        entries = [_entry(output, horizon_name(h), models, sides) for output in outputs for h in HORIZONS]
        found |= channel_documents(name, entries, sides.contender)
    return {"channels": found, "skipped": dict(skipped)}


def _entry(output: Signal, horizon: str, models: Mapping[str, Fitted], sides: Sides) -> Entry:
    rivals = sides.rivals if horizon == FREE_RUN else ()
    return Entry(
        output=output,
        horizon=horizon,
        models=dict.fromkeys(models, SCORE),
        pairs={name: _pair(name, sides.base) for name in models if name != sides.base},
        resolution=1.0,
        rivals={name: _pair(str(sides.contender), name) for name in rivals},
    )


def _pair(model: str, baseline: str) -> Pair:
    evidence = Evidence(1.0, 1.0, 1.0)
    basis = ErrorChange(Scope.ANOTHER, 1, 0, None, {})
    return Pair(
        *(model, baseline, 1.0, (1.0, 1.0), 1.0, 1.0, "flights"), basis, evidence, Verdict.SAME, "expected"
    )
