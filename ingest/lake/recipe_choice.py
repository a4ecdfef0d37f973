"""The recipe that is meant where none is named: that of the vehicle's commands and its responses to them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from flysid.errors import UsageError
from flysid.ingest.align.recipe import Recipe, load_recipe, shipped_recipes
from flysid.ingest.lake.lake import Lake
from flysid.showing import one_of


@dataclass(frozen=True)
class RecipeChoice:
    """A recipe that fits flights, and the others that fit them, too."""

    name: str
    others: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """For people."""
        others = f"; {', '.join(self.others)} would fit, too: --recipe chooses" if self.others else ""
        return f"recipe {self.name}{others}"


def check_shipped_channels(channels: Collection[str]) -> None:
    """Raise UsageError where no shipped recipe has one of these channels."""
    known = dict.fromkeys(c for name in shipped_recipes() for c in load_recipe(name).channels)
    for channel in channels:
        if channel not in known:
            raise UsageError(
                f"no shipped recipe has a channel {channel!r}", hint=one_of(list(known), channel)
            )


def choose_recipe(lake: Lake, channels: Collection[str] = ()) -> RecipeChoice:
    """The shipped recipe with the largest share of commands and responses among the channels it serves.

    `channels`: only recipes that serve these are looked at.
    Raises UsageError: none fits; or several do, and none is of a command and the response to it.
    """
    served = {name: own for name, own in lake.recipes().items() if set(channels) <= set(own)}
    shares = {name: _share(load_recipe(name), own) for name, own in served.items()}
    if not served or (len(served) > 1 and not any(shares.values())):
        raise _undecided(lake, served, channels)
    best = max(shares, key=shares.__getitem__)
    return RecipeChoice(best, tuple(name for name in served if name != best))


def commands_of(recipe: Recipe) -> tuple[str, ...]:
    """The channels that a recipe is chosen for: those of a command; all where there is none."""
    return tuple(c for c in recipe.channels if is_command(recipe, c)) or tuple(recipe.channels)


def is_command(recipe: Recipe, channel: str) -> bool:
    """Whether a channel is of one command and the response to it: both are in the same unit."""
    spec = recipe.channel(channel)
    units = {recipe.signals[name].unit for name in (*spec.inputs, *spec.outputs)}
    return len(spec.inputs) == 1 and len(units) == 1


def _share(recipe: Recipe, served: Collection[str]) -> float:
    return sum(is_command(recipe, channel) for channel in served) / len(served)


def _undecided(lake: Lake, served: Mapping[str, tuple[str, ...]], channels: Collection[str]) -> UsageError:
    """What to say where no recipe can be chosen."""
    place = lake.address or lake.folder
    if served:
        told = "; ".join(f"--recipe {name} ({', '.join(own)})" for name, own in served.items())
        return UsageError(f"{len(served)} recipes fit", path=place, hint=told)
    fitting = [f"{name} ({', '.join(own)})" for name, own in lake.recipes().items()]
    if channels and fitting:
        return UsageError(
            f"no recipe gives {', '.join(channels)} from these flights",
            path=place,
            hint=f"these fit: {'; '.join(fitting)}",
        )
    return UsageError("no shipped recipe fits", path=place, hint="--from FIELD --to FIELD needs no recipe")
