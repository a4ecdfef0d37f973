"""Generators that yield parts and return what is left to say: read to their end."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TypeVar

P = TypeVar("P")
T = TypeVar("T")


def exhaust(parts: Generator[P, None, T], take: Callable[[P], object]) -> T:
    """Hand every part on, one at a time; what the generator returns at its end."""
    while True:
        try:
            part = next(parts)
        except StopIteration as stop:
            found: T = stop.value
            return found
        take(part)
