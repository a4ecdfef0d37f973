"""What several ask for is done once: within `sharing()` an answer is remembered by its arguments.

When the scope ends, all is forgotten.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

_known: ContextVar[dict[Hashable, Any] | None] = ContextVar("answers", default=None)


class Itself:
    """An object as part of a key: equal to itself alone, and kept for as long as the key is."""

    def __init__(self, it: object) -> None:
        self.it = it

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Itself) and other.it is self.it

    def __hash__(self) -> int:
        return id(self.it)


@contextmanager
def sharing() -> Iterator[None]:
    """The scope in which answers are shared; a scope within a scope is part of it."""
    if _known.get() is not None:
        yield
        return
    token = _known.set({})
    try:
        yield
    finally:
        _known.reset(token)


def once(key: Callable[..., Hashable | None]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A function whose answer is remembered by `key` of its arguments; None: it is not."""

    def remembering(function: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(function)
        def asked(*args: P.args, **kwargs: P.kwargs) -> R:
            known = _known.get()
            at = None if known is None else key(*args, **kwargs)
            if known is None or at is None:
                return function(*args, **kwargs)
            whole = (function.__module__, function.__qualname__, at)
            if whole not in known:
                known[whole] = function(*args, **kwargs)
            answer: R = known[whole]
            return answer

        return asked

    return remembering
