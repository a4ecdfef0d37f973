"""A group of verbs, one small module each, imported only when that verb is run."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Mapping, Sequence
from typing import Any

import click

from flysid.cli.examples import epilog


class LazyVerbs(click.Group):
    """Imports a verb's module when the verb is run; `--help` imports none of them.

    Parameters
    ----------
    verbs : name -> what the verb does, in one line.
    modules : where the command of a verb is, e.g. "flysid.cli.{}".
    steps : heading -> verbs, as the help lists them; one list without.
    parent : the verb that these are verbs of.
    """

    def __init__(
        self,
        *args: Any,
        verbs: Mapping[str, str],
        modules: str,
        steps: Mapping[str, Sequence[str]] | None = None,
        parent: str = "",
        **settings: Any,
    ) -> None:
        super().__init__(*args, **{"subcommand_metavar": "VERB [ARGS]..."} | settings)
        self.verbs = verbs
        self._modules = modules
        self._steps = steps or {"Commands": tuple(verbs)}
        self._parent = parent

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return sorted(self.verbs)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        if cmd_name not in self.verbs:
            return None
        command: click.Command = importlib.import_module(self._modules.format(cmd_name)).command
        command.epilog = command.epilog or epilog(f"{self._parent} {cmd_name}".strip())
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        width = max(map(len, self.verbs))
        listed = {verb for verbs in self._steps.values() for verb in verbs}
        more = tuple(verb for verb in self.verbs if verb not in listed)
        for step, verbs in (dict(self._steps) | ({"More": more} if more else {})).items():
            with formatter.section(step):
                formatter.write_dl([(verb.ljust(width), self.verbs[verb]) for verb in verbs])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in self.verbs and not args[0].startswith("-"):
            near = difflib.get_close_matches(args[0], self.verbs, n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise click.UsageError(f"no verb {args[0]!r}.{hint}", ctx)
        return super().resolve_command(ctx, args)
