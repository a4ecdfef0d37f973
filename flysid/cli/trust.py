"""Which options a project's `flysid.toml` may set: a folder of logs may be a stranger's, and so its file.

An option that runs, imports, connects, listens, sends, deletes, loosens a limit, or reads and writes at a
place that it names is the user's own: the command line, the environment and the user's own file set it. What
is left says what is computed and how it is shown; a project may set that.

The class stands where the option is declared. Paths, addresses and texts without a class are the user's own,
so that a new option is refused until somebody has thought about it.
"""

from __future__ import annotations

from enum import Enum
from typing import Any

import click

from flysid.foreign import why_outside


class Who(Enum):
    """Who may set an option beside the command line, the environment and the user's own file."""

    USER = "nobody"
    PROJECT = "a project"
    PROJECT_INSIDE = "a project, where it names a file below its folder"


class Setting(click.Option):
    """A text that chooses among what data, recipes and models hold: channels, flights, models, limits."""


class ProjectFile(click.Option):
    """A text that may name a file, read and never run: a recipe, old gains, derivatives."""


class Own(click.Option):
    """A switch or a number that acts beyond the result: it deletes, sends, listens, or takes the machine."""


_SAFE_BY_TYPE = (
    click.Choice,
    click.types.BoolParamType,
    click.types.IntParamType,
    click.types.FloatParamType,
)
_OWN_BY_TYPE = (click.Path, click.File)


def who_may_set(option: click.Option) -> Who:
    """By the option's class; without one, by its type."""
    if isinstance(option, ProjectFile):
        return Who.PROJECT_INSIDE
    if isinstance(option, Setting):
        return Who.PROJECT
    if isinstance(option, Own) or not isinstance(option.type, _SAFE_BY_TYPE):
        return Who.USER
    return Who.PROJECT


def is_declared(option: click.Option) -> bool:
    """Whether a declaration says enough: a text without a class does not."""
    return isinstance(option, Own | Setting | ProjectFile) or isinstance(
        option.type, (*_SAFE_BY_TYPE, *_OWN_BY_TYPE)
    )


def files_named(value: Any) -> list[str]:
    """What a value of a `ProjectFile` may name.

    A value is a name, a path, or a list of both, with or without a label: "px4-rates",
    "line,structured:a.toml".
    """
    texts = value if isinstance(value, list) else [value]
    names = [name.strip() for text in texts for name in str(text).split(",")]
    bare = [name if why_outside(name) else name.rpartition(":")[2] for name in names]
    return [name for name in bare if name]
