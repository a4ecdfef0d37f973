"""`flysid recipes [NAME]`: the recipes that come with flysid, and what one of them takes from a log."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli import complete
from flysid.cli.addresses import SOURCE, here
from flysid.cli.display import Display
from flysid.place import is_address

if TYPE_CHECKING:
    from flysid.ingest.align.recipe import Recipe, Source


@click.command("recipes")
@click.argument("name", default="", shell_complete=complete.recipes)
@click.option(
    "--for",
    "source",
    type=SOURCE,
    metavar="LOG|DATA",
    help="Only recipes that fit this log, or a flight of this folder, with the channels that fit.",
)
@click.option("--toml", is_flag=True, help="Print the recipe's text, as a start for your own.")
def command(name: str, source: Path | None, toml: bool) -> None:
    """List the recipes, or explain one: its channels, signals, units and sources.

    Instead of a recipe's NAME, a log or a folder of flights lists the recipes that fit it, as --for does.
    """
    from flysid.cli.output import say
    from flysid.errors import UsageError
    from flysid.ingest.align.recipe import load_recipe, recipe_text, shipped_recipes
    from flysid.showing import fold

    if name and source is not None:
        raise UsageError("a recipe's name and --for are mutually exclusive", hint="give one of them")
    if name and source is None and is_log(name):
        name, source = "", here(name) if is_address(name) else Path(name)
    if toml and not name:
        raise UsageError("--toml prints one recipe", hint="flysid recipes NAME --toml")
    if toml:
        click.echo(recipe_text(name)[0], nl=False)
    elif name:
        click.echo("\n".join(explain(load_recipe(name))))
    else:
        served = _list_served(source)
        for recipe, channels in served.items():
            click.echo(fold(f"{recipe}: {', '.join(channels)}"))
            click.echo(fold(f"  {load_recipe(recipe).description}"))
        if not served:
            say(f"no recipe fits {source}; shipped ones: {', '.join(shipped_recipes())}")
            listed = f"'flysid show {source} --fields' lists the fields"
            say(f"next: {listed}; name two to 'flysid fit': --from, --to")


def is_log(name: str) -> bool:
    """Whether a name is no recipe's but a log's or a folder's: a recipe's own file is TOML."""
    from flysid.ingest.align.recipe import SUFFIX, shipped_recipes

    if name in shipped_recipes():
        return False
    return is_address(name) or (Path(name).suffix != SUFFIX and Path(name).exists())


def _list_served(source: Path | None) -> dict[str, tuple[str, ...]]:
    """Recipe -> its channels; of a log, those that it can serve."""
    from flysid.ingest.align.recipe import load_recipe, shipped_recipes

    if source is None:
        return {name: tuple(load_recipe(name).channels) for name in shipped_recipes()}
    from flysid.cli.source import opened_flights

    with Display().shown(), opened_flights(source, share=1.0) as lake:
        return lake.recipes()


def explain(recipe: Recipe) -> Iterator[str]:
    """A recipe in words: the channels first, then every signal with the places where it is looked for."""
    yield f"{recipe.name}: {recipe.description}" if recipe.description else recipe.name
    for name, channel in recipe.channels.items():
        yield ""
        yield f"channel {name}: {', '.join(channel.inputs)} -> {', '.join(channel.outputs)}"
        if channel.description:
            yield f"  {channel.description}"
        if channel.min_rate_hz:
            yield f"  needs at least {channel.min_rate_hz:g} Hz; {channel.remedy}".rstrip("; ")
    for name, signal in recipe.signals.items():
        yield ""
        unit = f" [{signal.unit}]" if signal.unit else ""
        yield f"signal {name}{unit}: {signal.description}".rstrip(": ")
        yield from (f"  {_place(source)}" for source in signal.sources)


def _place(source: Source) -> str:
    """Where a signal comes from, and what is done to it."""
    words = f"{source.stream}.{'/'.join(source.fields)}"
    if source.transform != "none":
        words += f", {source.transform}"
    if source.scale != 1.0:
        words += f", times {source.scale:g}"
    if source.offset:
        words += f", plus {source.offset:g}"
    if source.where:
        words += ", where " + " and ".join(f"{k} is {v}" for k, v in source.where.items())
    return words
