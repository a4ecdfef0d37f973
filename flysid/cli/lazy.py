"""A group of verbs, one small module each, imported only when that verb is run."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import click

from flysid.cli.verbs import Verb
from flysid.errors import UsageError
from flysid.offers import import_name, rows


class LazyVerbs(click.Group):
    """Imports a verb's module when the verb is run; `--help` imports none of them.

    `verbs`: rows of flysid's own, by name.
    `modules`: where the command of one of these is, e.g. "flysid.cli.{}:command".
    `group`: of the entry points by which other packages add verbs; "" where they cannot.
    `of_a_file`: the verb that is meant where a file or folder stands in place of a verb; "" for none.
    """

    def __init__(
        self,
        *args: Any,
        verbs: Mapping[str, Verb],
        modules: str,
        group: str = "",
        of_a_file: str = "",
        **settings: Any,
    ) -> None:
        super().__init__(*args, **{"subcommand_metavar": "VERB [ARGS]..."} | settings)
        self._own = verbs
        self._modules = modules
        self._group = group
        self._of_a_file = of_a_file

    @cached_property
    def verbs(self) -> Mapping[str, Verb]:
        """Every row by name: flysid's own, then those of installed packages.

        Raises UsageError: an installed package offers what is no verb, or a name that is taken.
        """
        every = dict(self._own)
        for offer, row in rows(self._group, Verb) if self._group else ():
            if row.name in every:
                raise offer.refusal(f"the name {row.name!r} is taken")
            if not row.command:
                raise offer.refusal("it does not say where its command is")
            every[row.name] = row
        return every

    def _listed(self) -> tuple[Mapping[str, Verb], str]:
        """What there is, and why verbs of packages are not among them: help and completion stand without."""
        try:
            return self.verbs, ""
        except UsageError as error:
            return self._own, str(error)

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return sorted(self._listed()[0])

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        row = self._own.get(cmd_name) or self.verbs.get(cmd_name)
        if row is None:
            return None
        command: click.Command = import_name(row.command or self._modules.format(cmd_name))
        command.epilog = command.epilog or row.epilog
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        verbs, fault = self._listed()
        if fault:
            formatter.write_paragraph()
            formatter.write_text(fault)
        width = max(map(len, verbs))
        for step, listed in _by_step(verbs.values()).items():
            with formatter.section(step):
                formatter.write_dl([(row.name.ljust(width), row.summary) for row in listed])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and args[0] not in self._own and args[0] not in self.verbs:
            if self._of_a_file and Path(args[0]).exists():
                return super().resolve_command(ctx, [self._of_a_file, *args])
            near = difflib.get_close_matches(args[0], self.verbs, n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            what = "verb and no file" if self._of_a_file and ("." in args[0] or "/" in args[0]) else "verb"
            raise click.UsageError(f"no {what} {args[0]!r}.{hint}", ctx)
        return super().resolve_command(ctx, args)


def _by_step(verbs: Iterable[Verb]) -> dict[str, list[Verb]]:
    listed: dict[str, list[Verb]] = {}
    for verb in verbs:
        listed.setdefault(verb.step, []).append(verb)
    return listed
