"""What a shell offers after Tab: recipes, models, flights and channels."""

from __future__ import annotations

from pathlib import Path

import click


def recipes(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Shipped recipes."""
    from flysid.ingest.align.recipe import shipped_recipes

    return [name for name in shipped_recipes() if name.startswith(incomplete)]


def channels(ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Channels of the recipe that stands on the line; of all recipes where there is none."""
    from flysid.errors import FlysidError
    from flysid.ingest.align.recipe import load_recipe, shipped_recipes

    try:
        chosen = [ctx.params["recipe"]] if ctx.params.get("recipe") else shipped_recipes()
        names = dict.fromkeys(channel for recipe in chosen for channel in load_recipe(recipe).channels)
    except FlysidError:
        return []
    return [name for name in names if name.startswith(incomplete)]


def flights(ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Flights of the folder that stands on the line; of `data` where there is none.

    Before an option's value is there, click leaves the line's arguments in `ctx.args`.
    """
    words = [*ctx.args, ctx.params.get("data") or ctx.params.get("source") or "data"]
    folders = [Path(word) / "flights" for word in words]
    names = sorted(path.name for folder in folders if folder.is_dir() for path in folder.iterdir())
    return [name for name in names if name.startswith(incomplete) and not name.startswith(".")]


def models(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Labels, the last of a list of them."""
    from flysid.errors import FlysidError
    from flysid.model.structures import OWN, table

    try:
        rows = table()
    except FlysidError:
        rows = OWN
    before, comma, begun = incomplete.rpartition(",")
    names = sorted(row.name for row in rows.values() if row.can_be_fitted)
    return [f"{before}{comma}{name}" for name in names if name.startswith(begun)]
