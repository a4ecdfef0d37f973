"""Antecedents that a person named, beside the signals of a recipe's channels: before there are data."""

from __future__ import annotations

from collections.abc import Sequence

from flysid.dataset import Signal
from flysid.errors import UsageError
from flysid.ingest.align.recipe import Recipe
from flysid.model.rules.regressor_layout import parse_antecedents

HIDDEN = "hidden "
"""An antecedent that begins so is a state that a model finds by itself: no recipe names it."""


def refused_antecedents(
    antecedents: Sequence[str], recipe: Recipe, channels: Sequence[str]
) -> dict[str, UsageError]:
    """Channels whose signals these antecedents are not of, with the reason.

    Raises
    ------
    UsageError : they are of none of the channels.
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
