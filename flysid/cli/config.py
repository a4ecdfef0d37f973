"""Options that a project sets once: `flysid.toml` in the working folder, one table a verb.

    [fit]
    holdout = 0.25
    models = "line,ts"

What the command line says wins over the environment (FLYSID_FIT_HOLDOUT=0.25), the environment over the file.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import click

from flysid.errors import UsageError
from flysid.files import remedy_unread, why_unread

FILE = "flysid.toml"


def defaults_of(verb: str, command: click.Command, verbs: Iterable[str], path: Path) -> dict[str, Any]:
    """What the file says of a verb's options, by their names inside click.

    Raises
    ------
    UsageError : the file is no TOML; a table names no verb, or a key none of its options.
    """
    try:
        document = tomllib.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise UsageError(
            f"the settings cannot be read: {why_unread(error)}", path=path, hint=remedy_unread(error)
        ) from error
    for name, table in document.items():
        if name not in verbs or not isinstance(table, dict):
            raise _refuse_unknown(f"no verb {name!r}", name, verbs, path)
    known = _options(command)
    found = {}
    for key, value in document.get(verb, {}).items():
        option = known.get(key.replace("_", "-"))
        if option is None or option.name is None:
            raise _refuse_unknown(
                f"'flysid {verb}' has no option {key!r}", key.replace("_", "-"), known, path
            )
        found[option.name] = [value] if option.multiple and not isinstance(value, list) else value
    return found


def environment_of(verb: str, command: click.Command, environment: Mapping[str, str]) -> dict[str, Any]:
    """What variables FLYSID_VERB_OPTION say of a verb's options, by their names inside click.

    Raises
    ------
    UsageError : a variable names none of its options.
    """
    if isinstance(command, click.Group):
        return {}
    prefix = f"FLYSID_{verb.upper()}_"
    known = _options(command)
    found: dict[str, Any] = {}
    for name, value in environment.items():
        if not name.startswith(prefix):
            continue
        key = name.removeprefix(prefix).lower().replace("_", "-")
        option = known.get(key)
        if option is None or option.name is None:
            raise _refuse_unknown(f"{name} is set, and 'flysid {verb}' has no option {key!r}", key, known)
        found[option.name] = value.split() if option.multiple else value
    return found


def _options(command: click.Command) -> dict[str, click.Option]:
    options = [p for p in command.params if isinstance(p, click.Option)]
    return {opt.lstrip("-"): p for p in options for opt in p.opts if opt.startswith("--")}


def _refuse_unknown(message: str, name: str, known: Iterable[str], path: Path | None = None) -> UsageError:
    near = difflib.get_close_matches(name, list(known), n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"one of {', '.join(known)}"
    return UsageError(message, path=path, hint=hint)
