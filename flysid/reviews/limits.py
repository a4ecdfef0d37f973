"""Limits of firmwares, from `limits.toml`: how good is a figure, and who says so."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from flysid.reviews.fact import Grade


@dataclass(frozen=True)
class Limit:
    """From which value on a figure is to be watched, and from which it is bad.

    Where `bad` lies below `watch`, less is worse.
    """

    watch: float
    bad: float
    unit: str
    source: str

    def grade(self, value: float) -> Grade:
        """Of a value.

        Examples
        --------
        >>> limit("vibration.ardupilot_vibe").grade(41.0).value, limit("estimator.satellites").grade(4).value
        ('watch', 'bad')
        """
        sign = 1.0 if self.bad >= self.watch else -1.0
        if sign * value >= sign * self.bad:
            return Grade.BAD
        return Grade.WATCH if sign * value >= sign * self.watch else Grade.GOOD


@cache
def limit(name: str) -> Limit:
    """The limit of this name, "section.figure"; KeyError where there is none."""
    section, figure = name.split(".")
    return Limit(
        **tomllib.loads(files(__package__).joinpath("limits.toml").read_text("utf-8"))[section][figure]
    )


def rate_lag_limit(axis: str) -> Limit:
    """Of how late a body rate follows, ms."""
    return limit("tracking.yaw_rate_lag" if axis == "yaw" else "tracking.rate_lag")
