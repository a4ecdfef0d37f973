"""The models that a run fits, by name, and the antecedents that a person named: before there are data."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from flysid.dataset import Dataset, Signal
from flysid.errors import UsageError
from flysid.ingest.align.recipe import Recipe
from flysid.ingest.excitation.dead_time import DeadTime, delays_to_try, least_delays
from flysid.model.base import Estimator
from flysid.model.capabilities import HasCheck
from flysid.model.linear_choice import FIRST
from flysid.model.rules.regressor_layout import parse_antecedents
from flysid.model.rules.search_settings import SearchSettings
from flysid.model.structures import Structure, table
from flysid.showing import one_of
from flysid.validate.runs.run import FitSettings

Delays = tuple[tuple[int, ...], tuple[int, ...]]
"""Delays in samples per input that the training data speak for, and those below which they show no answer."""
NO_DELAYS: Delays = ((), ())
HIDDEN = "hidden "
"""An antecedent that begins so is a state that a model finds by itself: no recipe names it."""


def estimators(
    settings: FitSettings, baseline: str = FIRST, delays: Delays = NO_DELAYS
) -> dict[str, Estimator]:
    """What a run fits in memory, by name, in the order of the table.

    Raises UsageError: `settings.models` names what is not there, or what the other settings leave out.
    """
    _check_names(settings)
    rows = [row for row in _fittable() if row.name == baseline or _is_wanted(row, settings)]
    return dict(_built(rows, settings, delays))


def streaming_estimators(settings: FitSettings, delays: Delays = NO_DELAYS) -> dict[str, Any]:
    """What a run fits from disk, by name, references first; errors as `estimators`."""
    _check_names(settings)
    rows = [row for row in _fittable() if row.streams]
    wanted = [row for row in rows if row.fitted == "always" or row.name in (settings.labels or (row.name,))]
    ordered = sorted(wanted, key=lambda row: (row.kind != "reference", row.name))
    return dict(_built(ordered, settings, delays))


def delays_of(late: Sequence[DeadTime], train: Dataset) -> Delays:
    """What the dead times found in training data say to models."""
    count = len(train.inputs)
    return delays_to_try(late, count), least_delays(late, count)


def check_settings(settings: FitSettings) -> None:
    """Raise UsageError where settings cannot be, whatever the data: a model's name, a model's file.

    A file is read here as far as the model's settings can tell of it: a fit takes minutes.
    """
    for estimator in estimators(settings).values():
        if isinstance(estimator, HasCheck):
            estimator.check_settings()
    for file in files_of(settings).values():
        if not file.is_file():
            raise UsageError("no such file", path=file)


def files_of(settings: FitSettings) -> dict[str, Path]:
    """The files behind models' names, by name."""
    named = (model.partition(":") for model in settings.models)
    return {label: Path(file) for label, mark, file in named if mark and file}


def _is_wanted(row: Structure, settings: FitSettings) -> bool:
    if row.fitted == "always":
        return True
    return row.name in settings.labels if settings.labels else row.fitted == "usually"


def _fittable() -> list[Structure]:
    return [row for row in table().values() if row.can_be_fitted]


def _built(rows: list[Structure], settings: FitSettings, delays: Delays) -> Iterator[tuple[str, Any]]:
    files = files_of(settings)
    given = {
        "antecedents": settings.antecedents or "auto",
        "flight_offsets": settings.own_constants,
        "nk_hint": delays[0],
        "nk_least": delays[1],
        "rules": settings.rules,
        "search": SearchSettings.of(settings.effort),
        "seed": settings.seed,
    }
    for row in rows:
        estimator = row.settings(given | {"file": files.get(row.name)})
        if estimator is not None:
            yield row.name, estimator
        elif row.name in settings.labels:
            raise UsageError(
                f"{row.name} is not fitted with --effort {settings.effort}", hint="give more effort"
            )


def _check_names(settings: FitSettings) -> None:
    rows = {row.name: row for row in _fittable()}
    for label, given in zip(settings.labels, settings.models, strict=True):
        if label not in rows:
            raise UsageError(f"no model {label!r}", hint=one_of(list(rows), label))
        if label != given and not rows[label].takes_file:
            takers = (f"{row.name}:FILE" for row in rows.values() if row.takes_file)
            raise UsageError(f"{label} takes no file", hint=f"{' or '.join(takers)} does")
        if rows[label].takes_file and settings.labels.count(label) > 1:
            raise UsageError(f"a run takes one {label} model", hint="fit the other into a run of its own")


def refused_antecedents(
    antecedents: Sequence[str], recipe: Recipe, channels: Sequence[str]
) -> dict[str, UsageError]:
    """Channels whose signals these antecedents are not of, with the reason.

    Raises UsageError: they are of none of the channels.
    """
    refused = {name: error for name in channels if (error := _refusal(antecedents, recipe, name)) is not None}
    if refused and len(refused) == len(channels):
        raise next(iter(refused.values()))
    return refused


def _refusal(antecedents: Sequence[str], recipe: Recipe, channel: str) -> UsageError | None:
    spec = recipe.channel(channel)
    outputs, inputs = (
        [Signal(name, recipe.signals[name].unit) for name in names] for names in (spec.outputs, spec.inputs)
    )
    named = [name for name in antecedents if not name.startswith(HIDDEN)]
    try:
        parse_antecedents(named, outputs, inputs, [1] * len(inputs))
    except UsageError as error:
        return error
    return None
