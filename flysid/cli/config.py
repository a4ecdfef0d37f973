"""Options that a project sets once: `flysid.toml` in the working folder, one table a verb.

    [fit]
    holdout = 0.25
    models = "line,ts"

What the command line says wins over the environment (FLYSID_FIT_HOLDOUT=0.25), the environment over the file.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from flysid.errors import UsageError

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
        raise UsageError(f"the settings cannot be read: {error}", path=path) from error
    for name, table in document.items():
        if name not in verbs or not isinstance(table, dict):
            raise _unknown(f"no verb {name!r}", name, verbs, path)
    known = {opt.lstrip("-"): p for p in command.params for opt in p.opts if opt.startswith("--")}
    found = {}
    for key, value in document.get(verb, {}).items():
        option = known.get(key.replace("_", "-"))
        if option is None or option.name is None:
            raise _unknown(f"'flysid {verb}' has no option {key!r}", key.replace("_", "-"), known, path)
        found[option.name] = value
    return found


def _unknown(message: str, name: str, known: Iterable[str], path: Path) -> UsageError:
    near = difflib.get_close_matches(name, list(known), n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"one of {', '.join(known)}"
    return UsageError(message, path=path, hint=hint)
