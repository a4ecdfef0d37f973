"""What a shell offers after Tab: recipes, models, flights and channels."""

from __future__ import annotations

from pathlib import Path

import click

MODELS = (
    "anfis", "armax", "arx", "bj", "ensemble", "fir", "iv", "line", "mean", "multirotor", "oe",
    "one_rule", "one_rule_ss", "persistence", "statespace", "static_ts", "tf", "ts", "ts_lags", "ts_ss",
)  # fmt: skip
"""Labels that `flysid fit --models` knows."""


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
    """Flights of the folder that stands on the line; of `data` where there is none."""
    folder = Path(ctx.params.get("data") or "data") / "flights"
    names = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    return [name for name in names if name.startswith(incomplete) and not name.startswith(".")]


def models(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Labels, the last of a list of them."""
    before, comma, begun = incomplete.rpartition(",")
    return [f"{before}{comma}{name}" for name in MODELS if name.startswith(begun)]
