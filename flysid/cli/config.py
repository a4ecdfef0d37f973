"""Options that are set once: `flysid.toml` of a project and of the user, and the environment.

A file has one table a verb:

    [fit]
    holdout = 0.25
    models = "line,ts"

    [fleet.fit]
    by = "month"

The command line wins over the environment (FLYSID_FIT_HOLDOUT=0.25), the environment over the project's file,
which lies in the working folder, and that over the user's own, in XDG_CONFIG_HOME/flysid. The working folder
may be a stranger's: what its file may not set (`flysid.cli.trust`) is refused, all of it at once, and nothing
is done.
"""

from __future__ import annotations

import difflib
import os
import stat
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from flysid.cli.lazy import LazyVerbs
from flysid.cli.tomllines import lines_of
from flysid.cli.trust import Who, files_named, who_may_set
from flysid.errors import StoreError, UsageError
from flysid.files import remedy_unread, why_unread
from flysid.foreign import inner_path
from flysid.showing import counted

FILE = "flysid.toml"
LARGEST_BYTES = 1 << 20
"""Of a settings file; a text that somebody has written is a thousandth of it."""


def take_settings(ctx: click.Context) -> None:
    """What files and the environment say of the verb that is about to run becomes its defaults.

    Raises UsageError: a file is no TOML; a table names no verb, or a key none of its options; the project's
    file sets what it may not.
    """
    group = ctx.command
    verb = ctx.invoked_subcommand
    if not isinstance(group, LazyVerbs) or verb is None:
        return
    command = group.get_command(ctx, verb)
    if command is None or isinstance(command, click.Group):
        return
    asked = _Asked((*_words(ctx), verb), command, ctx)
    ctx.default_map = {verb: settings_of(asked, Path(FILE), own_file(os.environ), os.environ)}


@dataclass(frozen=True)
class _Asked:
    """The verb that is about to run: its words, its command, and the context of the group that it is in."""

    words: tuple[str, ...]
    command: click.Command
    group: click.Context

    @property
    def verbs(self) -> tuple[tuple[str, ...], ...]:
        """The verbs that each word is one of."""
        return _verbs(self.group)

    @property
    def name(self) -> str:
        return " ".join(("flysid", *self.words))


@dataclass(frozen=True)
class _Said:
    """What a file says of one option."""

    option: click.Option
    key: str
    value: Any
    line: int


def own_file(environment: Mapping[str, str]) -> Path:
    """The user's own settings. A relative XDG_CONFIG_HOME is void, as its specification wants."""
    base = Path(environment.get("XDG_CONFIG_HOME", ""))
    return (base if base.is_absolute() else Path.home() / ".config") / "flysid" / FILE


def settings_of(asked: _Asked, project: Path, own: Path, environment: Mapping[str, str]) -> dict[str, Any]:
    """All settings of a verb's options, by their names inside click."""
    found = {said.option.name: _value(said) for said in _settings_of(own, asked)}
    if not _is_same(project, own):
        told = list(_settings_of(project, asked))
        _refuse_what_is_not_the_projects(told, project, own, asked)
        found |= {said.option.name: _value(said) for said in told}
    return {str(name): value for name, value in found.items()} | environment_of(asked, environment)


def environment_of(asked: _Asked, environment: Mapping[str, str]) -> dict[str, Any]:
    """What variables FLYSID_VERB_OPTION say of a verb's options, by their names inside click.

    Raises UsageError: a variable names none of its options.
    """
    prefix = f"FLYSID_{'_'.join(asked.words).upper()}_"
    known = _options(asked.command)
    found: dict[str, Any] = {}
    for name, value in environment.items():
        if not name.startswith(prefix):
            continue
        key = name.removeprefix(prefix).lower().replace("_", "-")
        option = known.get(key)
        if option is None or option.name is None:
            raise _refuse_unknown(f"{name} is set, and '{asked.name}' has no option {key!r}", key, known)
        found[option.name] = value.split() if option.multiple else value
    return found


def _words(ctx: click.Context) -> tuple[str, ...]:
    """The verbs that lead to a context."""
    return () if ctx.parent is None else (*_words(ctx.parent), str(ctx.info_name))


def _verbs(ctx: click.Context | None) -> tuple[tuple[str, ...], ...]:
    """The verbs of a group, below those of the groups above it."""
    if ctx is None or not isinstance(ctx.command, LazyVerbs):
        return ()
    return (*_verbs(ctx.parent), tuple(ctx.command.verbs))


def _is_same(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)
    except OSError:
        return False


def _settings_of(path: Path, asked: _Asked) -> Iterator[_Said]:
    """What a file says of a verb's options, in its order."""
    text = _text(path)
    if text is None:
        return
    try:
        table: Any = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"the settings cannot be read: {error}", path=path) from error
    for word, verbs in zip(asked.words, asked.verbs, strict=True):
        for name, below in table.items():
            if not isinstance(below, dict) or name not in verbs:
                raise _refuse_unknown(f"no verb {name!r}", name, verbs, path)
        table = table.get(word, {})
    known = _options(asked.command)
    lines = lines_of(text) if table else {}
    for key, value in table.items():
        option = known.get(key.replace("_", "-"))
        if option is None or option.name is None:
            raise _refuse_unknown(f"'{asked.name}' has no option {key!r}", key.replace("_", "-"), known, path)
        yield _Said(option, key, value, lines.get((*asked.words, key), 0))


def _text(path: Path) -> str | None:
    """A settings file; None where there is none."""
    try:
        state = path.stat()
        if not stat.S_ISREG(state.st_mode) or state.st_size > LARGEST_BYTES:
            raise UsageError(
                f"the settings cannot be read: not a file of at most {LARGEST_BYTES:,} bytes", path=path
            )
        return path.read_text("utf-8")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise UsageError(
            f"the settings cannot be read: {why_unread(error)}", path=path, hint=remedy_unread(error)
        ) from error


def _value(said: _Said) -> Any:
    return [said.value] if said.option.multiple and not isinstance(said.value, list) else said.value


def _refuse_what_is_not_the_projects(told: Sequence[_Said], project: Path, own: Path, asked: _Asked) -> None:
    """Raise UsageError that names every option that the file of a project may not set, with its line."""
    refused = [said for said in told if not _may_stand(said, project)]
    if not refused:
        return
    places = ", ".join(f"{said.key} ({project}:{said.line})" for said in refused)
    raise UsageError(
        f"the working folder may not set {counted(len(refused), 'option')} of '{asked.name}': {places}. "
        "Such options run, connect, delete, or read and write at a place that they name, and the folder may "
        "be a stranger's; nothing was done",
        path=project,
        hint=f"if you mean it, move them to the command line or to {own}; else remove them",
    )


def _may_stand(said: _Said, project: Path) -> bool:
    who = who_may_set(said.option)
    if who is not Who.PROJECT_INSIDE:
        return who is Who.PROJECT
    try:
        for name in files_named(said.value):
            inner_path(project.absolute().parent, name, project)
    except StoreError:
        return False
    return True


def _options(command: click.Command) -> dict[str, click.Option]:
    options = [p for p in command.params if isinstance(p, click.Option)]
    return {opt.lstrip("-"): p for p in options for opt in p.opts if opt.startswith("--")}


def _refuse_unknown(message: str, name: str, known: Iterable[str], path: Path | None = None) -> UsageError:
    near = difflib.get_close_matches(name, list(known), n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"one of {', '.join(known)}"
    return UsageError(message, path=path, hint=hint)
