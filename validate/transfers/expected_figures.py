"""The figures of loops that `flysid tf` will give, known from the recipe alone.

`--fail-if` is tried on them first: a misspelt field costs a second then, and not the whole identification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flysid.errors import UsageError
from flysid.ingest.align.recipe import Recipe, load_recipe
from flysid.model.frequency.loop_figures import COMMAND, LOOP
from flysid.validate.compare.condition import check_condition

FIGURE = {"value": 1.0, "low": 1.0, "high": 1.0}
"""Of the right types; the numbers mean nothing."""


@dataclass(frozen=True)
class Figures:
    """What the figures must satisfy.

    Attributes
    ----------
    channels : of the recipe; empty: all.
    reference, reference_at : as `transfers.identify`.
    condition : that ends in a failure, or None.
    """

    channels: tuple[str, ...] = ()
    reference: tuple[str, ...] = ()
    reference_at: str = ""
    condition: str | None = None

    def check(self, recipe_name: str) -> None:
        """Raise UsageError where the recipe's channels cannot have a requested figure."""
        recipe = load_recipe(recipe_name)
        for name in recipe.chosen(self.channels):
            if self.reference_at:
                check_reference(self.reference or recipe.channel(name).reference)
        if self.condition is None:
            return
        try:
            check_condition(self.condition, self._expected(recipe))
        except UsageError as error:
            self._ask_for_reference(recipe, error)
            raise

    def _ask_for_reference(self, recipe: Recipe, refused: UsageError) -> None:
        """Raise UsageError where the condition would be understood if the loop's reference were known."""
        try:
            check_condition(self.condition or "", self._expected(recipe, every_loop=True))
        except UsageError:
            return
        raise UsageError(
            f"{refused.message}: nothing says what drives the loop, and where",
            hint="--reference FIELD --reference-at input, or setpoint; or a recipe that knows, such as "
            "ardupilot-sysid",
        ) from refused

    def _expected(self, recipe: Recipe, *, every_loop: bool = False) -> dict[str, Any]:
        body = {}
        for name in recipe.chosen(self.channels):
            spec = recipe.channel(name)
            groups = dict.fromkeys(command_groups(spec.inputs, spec.outputs), COMMAND)
            if every_loop or self.reference_at or spec.reference_at:
                groups["loop"] = LOOP
            body[name] = {group: dict.fromkeys(names, FIGURE) for group, names in groups.items()}
        return {"channels": body}


def command_groups(inputs: Sequence[str], outputs: Sequence[str]) -> list[str]:
    """What the figures of a channel's commands go by: every output's, input by input."""
    if len(inputs) * len(outputs) == 1:
        return ["command"]
    return [f"command_{source}_{output}" for output in outputs for source in inputs]


def check_reference(reference: Sequence[str]) -> None:
    """Raise UsageError where margins cannot be had: they need the one signal that drives the loop."""
    if len(reference) != 1:
        raise UsageError(
            "margins belong to the loop cut open, which a response from command to output does not show",
            hint="name the one signal that drives the loop: --reference FIELD",
        )
