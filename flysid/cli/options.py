"""Groups of options: each is declared once, and a verb takes it as one value."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

import click

from flysid.cli import complete
from flysid.cli.output import FORMS, check_target, chosen_form
from flysid.cli.trust import Own, Setting

F = TypeVar("F", bound=Callable[..., Any])
Decorator = Callable[[Any], Any]


def gather(name: str, make: Callable[..., Any], *options: Decorator) -> Callable[[F], F]:
    """A decorator that adds options to a verb, which takes them as one value.

    `name`: of the verb's parameter.
    `make`: makes the value of what was given, by the options' names: a dataclass, or a function.
    `options`: `click.option` or `click.argument`, in the order of the help.
    """

    def decorate(function: F) -> F:
        @wraps(function)
        def verb(*args: Any, **given: Any) -> Any:
            own = {option: given.pop(option) for option in names}
            return function(*args, **{name: make(**own)}, **given)

        decorated: Any = verb
        before = len(getattr(verb, "__click_params__", ()))
        for option in reversed(options):
            decorated = option(decorated)
        names = [parameter.name for parameter in decorated.__click_params__[before:]]
        chosen: F = decorated
        return chosen

    return decorate


def force_option(replaced: str) -> Decorator:
    """--force; its help names what is replaced."""
    return click.option("--force", cls=Own, is_flag=True, help=f"Replace the {replaced} if it exists.")


def jobs_option(words: str) -> Decorator:
    """--jobs; 0 where it is not given."""
    return click.option(
        "--jobs", "-j", cls=Own, default=0, type=click.IntRange(min=0), metavar="N", help=words
    )


def effort_option(words: str) -> Decorator:
    """--effort of the search for rules."""
    kinds = click.Choice(["quick", "normal", "thorough"])
    return click.option("--effort", default="normal", show_default=True, type=kinds, help=words)


def condition_option(example: str) -> Decorator:
    """--fail-if, as `condition`."""
    words = f"Exit with 4 if this holds, e.g. {example}."
    return click.option("--fail-if", "condition", cls=Setting, help=words)


channels_option = click.option(
    "--channel",
    "-c",
    "channels",
    cls=Setting,
    multiple=True,
    shell_complete=complete.channels,
    help="Only this channel; repeatable.",
)


def target_options(*flags: str, replaced: str, **settings: Any) -> Callable[[F], F]:
    """The option of a file or folder to write, and --force; the verb takes the path once it may be written.

    `flags`: of the option, as `click.option` takes them.
    `replaced`: see `force_option`.
    `settings`: of the option besides.
    """
    option = click.option(*flags, **{"type": click.Path(path_type=Path), **settings})
    name = max(flags, key=len).lstrip("-")

    def checked(force: bool, **target: Path | None) -> Path | None:
        if (path := target[name]) is not None:
            check_target(path, force)
        return path

    return gather(name, checked, option, force_option(replaced))


def picture_options(what: str) -> Callable[[F], F]:
    """--plot and --force; the verb takes the path as `plot`, once a picture may be drawn there."""

    def checked(plot: Path | None, force: bool) -> Path | None:
        if plot is not None:
            from flysid.pictures import check_picture

            check_picture(plot)
            check_target(plot, force, makes_folders=False)
        return plot

    file = click.Path(dir_okay=False, path_type=Path)
    option = click.option("--plot", type=file, help=f"Write {what} to this file.")
    return gather("plot", checked, option, force_option("plot"))


comparison_forms = gather(
    "form",
    chosen_form,
    *(
        click.option(f"--{name}", is_flag=True, help=f"Print the comparison as {what}.")
        for name, what in FORMS.items()
    ),
)
"""--json, --markdown and --csv; the verb takes the name of one of them, or "table"."""
