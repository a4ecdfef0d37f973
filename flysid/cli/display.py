"""How a verb shows what it is at: a live table on a terminal, lines in a pipe, JSON for programs."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import click

from flysid.cli.options import gather
from flysid.cli.output import say
from flysid.escaping import one_line
from flysid.progress import Step, listening
from flysid.showing import duration

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

SILENCE_S = 10.0
"""Longest time without a line."""
UNIT = "validation: free-run RMSE on data held back from training, in standard deviations of the output"


@dataclass(frozen=True)
class Display:
    """What the command line asks for."""

    progress: str = "auto"
    quiet: bool = False
    verbose: bool = False

    @property
    def live(self) -> bool:
        """A table on a terminal, and no lines."""
        return self.progress == "auto" and not self.quiet and sys.stderr.isatty()

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Show the progress of the work in the block (`flysid.progress`)."""
        state = State()
        if self.progress == "json":
            with _speaking(state, lambda step: state.as_json(step), every_step=True):
                yield
        elif self.quiet:
            yield
        elif self.live:
            with _table(state, self.verbose):
                yield
        else:
            with _speaking(state, lambda step: state.line(step), every_step=self.verbose):
                yield


progress_options = gather(
    "display",
    Display,
    click.option(
        "--progress",
        default="auto",
        show_default=True,
        type=click.Choice(["auto", "json"]),
        help="Progress on stderr, for people or as one JSON object per line.",
    ),
    click.option("--verbose", "-v", is_flag=True, help="Print every step."),
    click.option("--quiet", "-q", is_flag=True, help="Print errors and warnings only."),
)
"""--progress, --verbose and --quiet; the verb takes them as `display`."""


@dataclass
class State:
    """Progress so far.

    `last`: step of every channel; of all the work under "".
    `validation`: error by channel and model.
    `share`: of all the work that is done.
    `whole`: seconds that all of it takes, by the share and the time when the share last rose.
    """

    started: float = field(default_factory=time.monotonic)
    last: dict[str, Step] = field(default_factory=dict)
    validation: dict[tuple[str, str], float] = field(default_factory=dict)
    share: float = 0.0
    whole: float = 0.0

    def hear(self, step: Step) -> None:
        self.last[step.channel] = step
        if (step.share or 0.0) > self.share:
            self.share = step.share or 0.0
            self.whole = self.seconds / self.share
        if step.validation is not None:
            self.validation[step.channel, step.model] = step.validation

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.started

    @property
    def left(self) -> str:
        """ "about 40 s left", as far as the past tells the future; "" where it does not.

        It falls while a step takes its time, and is no longer shown where the step took longer than
        foreseen. Less than a third of the work tells too little of the rest.
        """
        left = self.whole - self.seconds
        if not 1.0 / 3.0 <= self.share < 1.0 or left < 1.0:
            return ""
        return f"about {duration(left)} left"

    def as_json(self, step: Step) -> str:
        """One object for programs."""
        known = {"channel": step.channel, "model": step.model, "stage": step.stage}
        known |= {"log": step.log} if step.log else {}
        found = {} if step.validation is None else {"validation": step.validation}
        return json.dumps(known | {"share": round(self.share, 4), "seconds": round(self.seconds, 2)} | found)

    def line(self, step: Step) -> str:
        """One line for people."""
        about = [part for part in (step.channel, step.log, step.model) if part]
        error = "" if step.validation is None else f", validation {step.validation:.3g}"
        left = f", {self.left}" if self.left else ""
        said = f"{': '.join([*about, step.stage])}{error}"
        return f"{duration(self.seconds):>7} {100.0 * self.share:3.0f} %  {said}{left}"


@contextmanager
def _speaking(state: State, words: Callable[[Step], str], every_step: bool) -> Iterator[None]:
    """A line of words for every step, or for those with a result; and where it is silent for too long."""
    done = threading.Event()
    lock = threading.Lock()
    latest: list[Step] = []
    spoken = [time.monotonic()]

    def speak(step: Step) -> None:
        spoken[0] = time.monotonic()
        click.echo(one_line(words(step)), err=True)

    def hear(step: Step) -> None:
        with lock:
            state.hear(step)
            latest[:] = [step]
            if every_step or step.result is not None:
                speak(step)

    def fill_silence() -> None:
        while not done.wait(SILENCE_S / 2):
            with lock, suppress(OSError, ValueError):  # whoever read us has gone
                if latest and time.monotonic() - spoken[0] >= SILENCE_S / 2:
                    speak(latest[0])

    thread = threading.Thread(target=fill_silence, daemon=True)
    thread.start()
    try:
        with listening(hear):
            yield
    finally:
        done.set()
        thread.join()


@contextmanager
def _table(state: State, verbose: bool) -> Iterator[None]:
    """The state as a table that changes in place."""
    from rich.console import Console
    from rich.live import Live

    def hear(step: Step) -> None:
        state.hear(step)
        if verbose:
            say(state.line(step))

    live = Live(get_renderable=lambda: drawn(state), console=Console(stderr=True), refresh_per_second=4)
    with live:
        try:
            with listening(hear):
                yield
        finally:
            live.transient = not state.validation  # what was found stays


def drawn(state: State) -> Group:
    """The table of channels, and a line on the whole."""
    from rich.console import Group
    from rich.text import Text

    told = state.last.get("")
    whole = f"{told.log}: {told.stage}" if told and told.log else told.stage if told else ""
    foot = ", ".join(
        part for part in (f"{100.0 * state.share:.0f} % done", duration(state.seconds), state.left) if part
    )
    lines = [Text(one_line(f"{whole}  {foot}".strip()), no_wrap=True, overflow="ellipsis")]
    channels = [name for name in state.last if name]
    if not channels:
        return Group(*lines)
    if state.validation:
        lines.insert(0, Text(UNIT, style="dim"))
    return Group(_channel_table(state, channels), *lines)


def _channel_table(state: State, channels: list[str]) -> Table:
    from rich.table import Table
    from rich.text import Text

    models = list(dict.fromkeys(model for _, model in state.validation))
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in ("CHANNEL", *models, "NOW"):
        table.add_column(
            Text(one_line(name)), justify="left" if name in ("CHANNEL", "NOW") else "right", no_wrap=True
        )
    for channel in channels:
        step = state.last[channel]
        errors = {model: state.validation.get((channel, model)) for model in models}
        best = min((e for e in errors.values() if e is not None), default=None)
        cells = [
            Text("" if e is None else f"{e:.3g}", style="bold green" if e == best else "")
            for e in errors.values()
        ]
        now = f"{step.model}: {step.stage}" if step.model else step.stage
        table.add_row(Text(one_line(channel)), *cells, Text(one_line(now), overflow="ellipsis"))
    return table
