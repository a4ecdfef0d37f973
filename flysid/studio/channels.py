"""What a flight can identify: the command line's suggestion, the aligned signals, recipes of one's own."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from flysid.dataset import Dataset
from flysid.errors import RecipeError, StoreError, UsageError
from flysid.escaping import toml_document
from flysid.facts.clock import log_clock
from flysid.files import slug, write_atomically
from flysid.foreign import inner_path
from flysid.ingest.align.recipe import load_recipe, parse_recipe, recipe_text, shipped_recipes
from flysid.ingest.lake.stretches import Stretches, beginnings, parse_part
from flysid.manifest import FLIGHTS, read_manifest
from flysid.model.structures import table
from flysid.studio.flights import lake_of
from flysid.studio.folders import NotThere, Workspace
from flysid.studio.forms import Aligned, Draft
from flysid.validate.show.page.decimate import decimate, round_for_json

INFINITE = ("inf", "-inf")
POINTS = 1500  # of a signal: more than a page is wide


def listed_models() -> list[dict[str, Any]]:
    """Name of every structure that a fit may be given, and whether it is fitted where none is named."""
    rows = (row for row in table().values() if row.can_be_fitted and row.fitted != "always")
    return [{"name": row.name, "usual": row.fitted == "usually"} for row in rows]


class Recipes:
    """The shipped recipes and those in the studio's folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def listing(self) -> list[dict[str, Any]]:
        """Name, description, channels and whether it can be changed, for every recipe that is sound."""
        own = [str(path) for path in sorted(self._folder.glob("*.toml"))]
        listed = []
        for place in (*own, *shipped_recipes()):
            try:
                recipe = load_recipe(place)
            except RecipeError as error:
                listed.append(
                    {"name": Path(place).stem, "error": error.advice, "own": place in own, "channels": []}
                )
                continue
            channels = [
                {"name": name, "inputs": c.inputs, "outputs": c.outputs}
                for name, c in recipe.channels.items()
            ]
            listed.append(
                {
                    "name": Path(place).stem if place in own else place,
                    "description": recipe.description,
                    "own": place in own,
                    "channels": channels,
                }
            )
        return listed

    def place(self, name: str) -> str:
        """What the command line takes for a recipe: its name, or the path of one's own."""
        if slug(name) == name:
            path = inner_path(self._folder, f"{name}.toml", self._folder)
            if path.is_file():
                return str(path)
        if name in shipped_recipes():
            return name
        raise NotThere(f"no recipe {name!r}")

    def read(self, name: str) -> dict[str, Any]:
        """A recipe as TOML and as the values of a form."""
        text, _ = recipe_text(self.place(name))
        return {"name": name, "toml": text, "form": _as_form(tomllib.loads(text))}

    def write(self, name: str, draft: Draft) -> dict[str, Any]:
        """Keep a recipe of one's own.

        Raises UsageError: a name that is no file name or that a shipped recipe has. Raises RecipeError: not
        sound.
        """
        if not name or slug(name) != name:
            raise UsageError(f"{name!r} cannot be a recipe's name", hint=slug(name))
        if name in shipped_recipes():
            raise UsageError(f"{name} is a shipped recipe", hint=f"{name}-mine")
        found = judged(draft, name)
        try:
            write_atomically(self._folder / f"{name}.toml", found["toml"].encode())
        except OSError as error:
            raise StoreError(f"the recipe cannot be kept: {error.strerror}", path=self._folder) from error
        return {"name": name, **found}


def judged(draft: Draft, name: str = "recipe") -> dict[str, Any]:
    """A recipe that is sound, as TOML and as the values of a form.

    Raises UsageError: neither of them is given. Raises RecipeError: not sound.
    """
    text = draft.toml if draft.toml is not None else _as_toml(draft.form)
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise RecipeError(f"not TOML: {error}", path=name) from error
    parse_recipe(document, name)
    return {"toml": text, "form": _as_form(document)}


def _as_toml(form: dict[str, Any] | None) -> str:
    if form is None:
        raise UsageError("a recipe is given as 'toml' or as 'form'")
    try:
        return toml_document(_with(form, lambda value: float(value) if value in INFINITE else value))
    except (TypeError, ValueError, RecursionError) as error:
        raise RecipeError(f"wrong value: {error}") from error


def _as_form(document: dict[str, Any]) -> Any:
    """With infinite numbers as words, which JSON has none for."""
    return _with(document, lambda value: str(value) if value in (math.inf, -math.inf) else value)


def _with(part: Any, change: Callable[[Any], Any]) -> Any:
    """A document with every value in it changed."""
    if isinstance(part, dict):
        return {key: _with(value, change) for key, value in part.items()}
    return [_with(value, change) for value in part] if isinstance(part, list) else change(part)


def align_channel(workspace: Workspace, recipes: Recipes, asked: Aligned) -> dict[str, Any]:
    """The segments of a channel in one flight, and their signals thinned to what a page can show.

    `boots` holds the number of each, the beginning from which the command line counts times, and the end.
    Raises NotThere: no such flight or recipe. Raises RecipeError, DataError: the flight does not give the
    channel.
    """
    lake = lake_of(workspace.data, asked.f)
    mine = tuple(part for part in asked.x if parse_part(part).flight == asked.f)
    lake = replace(lake, stretches=Stretches(without=mine))
    found = lake.align(load_recipe(recipes.place(asked.r)), asked.ch)
    manifest = read_manifest(workspace.data / FLIGHTS / asked.f)
    offsets = log_clock(manifest.clocks).offsets_s
    ends_ns = {clock.boot: clock.last_ns for clock in manifest.clocks}
    begins_ns = sorted(beginnings(lake.logs[0]).items())
    data = found.dataset
    return {
        "flight": asked.f,
        "recipe": asked.r,
        "channel": asked.ch,
        "dt_s": data.dt_s,
        "segments": [_segment(data, k, offsets) for k in range(len(data.segments))],
        "signals": [[s.name, s.unit] for s in (*data.inputs, *data.outputs)],
        "lines": found.report.lines(),
        "used_s": found.report.used_s,
        "boots": [
            [boot, *(ns * 1e-9 + offsets.get(boot, 0.0) for ns in (begin_ns, ends_ns.get(boot, begin_ns)))]
            for boot, begin_ns in begins_ns
        ],
    }


def _segment(data: Dataset, index: int, offsets: dict[int, float]) -> dict[str, Any]:
    segment = data.segments[index]
    boot = int(segment.flight.rpartition("#")[2]) if "#" in segment.flight else min(offsets, default=0)
    time_s = segment.time_s(data.dt_s) + offsets.get(boot, 0.0)
    columns = {str(i): segment.u[:, i] for i in range(segment.u.shape[1])}
    columns |= {str(len(columns) + i): segment.y[:, i] for i in range(segment.y.shape[1])}
    share = max(50, POINTS * len(segment) // max(1, sum(map(len, data.segments))))
    shown_s, shown = decimate(time_s, columns, share)
    return {
        "start_s": float(time_s[0]),
        "end_s": float(time_s[-1]),
        "marks": dict(segment.marks),
        "time_s": round_for_json(shown_s, 6),
        "values": [round_for_json(values) for values in shown.values()],
    }
