"""Inputs of filter chains: quantities over time, each holding its last value."""

from __future__ import annotations

from typing import Protocol

from flysid.dataset import FloatArray


class Moving(Protocol):
    """A quantity over time: a column of a log."""

    @property
    def time_s(self) -> FloatArray:
        """(N,) rising."""

    @property
    def values(self) -> FloatArray:
        """(N,)"""

    def held(self, time_s: FloatArray) -> FloatArray:
        """(n,) in force at other times; NaN before the first."""


def thinned(moving: Moving, most: int = 1000) -> FloatArray:
    """Times of some of its values, evenly chosen: enough for a mean over the flight."""
    return moving.time_s[:: max(1, len(moving.time_s) // most)]
