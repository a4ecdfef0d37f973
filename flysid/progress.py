"""Progress of long work: one small record a step, handed to whoever listens.

Whoever does the work calls `tell` and knows nothing of who listens: a table on a terminal, lines in a pipe, a
program that reads JSON. Where nobody listens it costs next to nothing. Whoever calls the work states in a
`part` what it is about, and which part of the whole.

>>> with listening(lambda step: print(step.channel, step.model, step.stage, step.share)):
...     with part(0.5, 1.0, channel="roll", model="ts"):
...         tell("2 rules", share=0.5)
roll ts 2 rules 0.75
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from typing import Any


@dataclass(frozen=True)
class Step:
    """One step of long work.

    `stage`: what is being done, or was just done, in a few words.
    `channel`, `model`, `log`: what it is about; "" where that is all of them.
    `share`: of all the work that is done, 0 to 1; None where the step does not know.
    `validation`: free-run RMSE of the model on data that it was not fitted to, in standard deviations of the
        output; None where the step found none.
    `result`: what could be used if the work ended here; not shown to anybody.
    """

    stage: str
    channel: str = ""
    model: str = ""
    log: str = ""
    share: float | None = None
    validation: float | None = None
    result: Any = None


Listener = Callable[[Step], None]
_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


def tell(
    stage: str,
    *,
    share: float | None = None,
    validation: float | None = None,
    result: Any = None,
    **about: str,
) -> None:
    """Tell the listener, if there is one, of a step; `about` may hold `channel`, `model` and `log`."""
    relay(Step(stage, share=share, validation=validation, result=result, **about))


def relay(step: Step) -> None:
    """Hand a step to the listener, if there is one: one from another process, say."""
    listener = _listener.get()
    if listener is not None:
        listener(step)


@contextmanager
def listening(listener: Listener) -> Iterator[None]:
    """Hand every step of the block to `listener`, and to no other."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)


@contextmanager
def through(change: Callable[[Step], Step]) -> Iterator[None]:
    """Hand every step of the block to `change` first, and what it returns to the listener."""
    outer = _listener.get()

    def changed(step: Step) -> None:
        step = change(step)
        if outer is not None:
            outer(step)

    with listening(changed):
        yield


@contextmanager
def part(begin: float = 0.0, end: float = 1.0, **about: str) -> Iterator[None]:
    """Steps of the block are `about` this, and of the work's part from `begin` to `end`."""

    def placed(step: Step) -> Step:
        share = None if step.share is None else begin + (end - begin) * step.share
        unsaid: dict[str, Any] = {name: value for name, value in about.items() if not getattr(step, name)}
        return replace(step, share=share, **unsaid)

    with through(placed):
        yield
