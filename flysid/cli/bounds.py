"""Numbers within bounds; --max-memory and --max-time: quantities with units, for one log."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.options import gather
from flysid.cli.trust import Own

if TYPE_CHECKING:
    from flysid.ingest.lake.workers import Bounds


class Number(click.FloatRange):
    """A number within bounds: neither infinite nor "nan", which no bound keeps out."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


POSITIVE = Number(min=0.0, min_open=True)
NOT_NEGATIVE = Number(min=0.0)
COUNT = click.IntRange(min=0)
AT_LEAST_ONE = click.IntRange(min=1)
ALARM_RATE = Number(min=0.0, min_open=True, max=3600.0)
"""False alarms per hour: at most one a second."""

MEMORY = {"": 1.0, "B": 1.0, "KB": 10**3, "MB": 10**6, "GB": 10**9, "KIB": 2**10, "MIB": 2**20, "GIB": 2**30}
TIME = {"": 1.0, "MS": 1e-3, "S": 1.0, "MIN": 60.0, "H": 3600.0}
LEAST_MEMORY = 256 * 10**6


def quantity(text: str, units: dict[str, float]) -> float | None:
    """ "2GB", "10 min", ... in the smallest unit; None for "none" (no bound).

    Raises click.BadParameter: not a positive number with one of `units`.
    """
    if text.strip().lower() == "none":
        return None
    found = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([a-zA-Z]*)\s*", text)
    if found is None or found[2].upper() not in units or float(found[1]) <= 0:
        raise click.BadParameter(
            f"{text!r} is not a positive number with a unit; units: {', '.join(filter(None, units))}"
        )
    return float(found[1]) * units[found[2].upper()]


def _memory(_ctx: click.Context, _param: click.Parameter, value: str) -> int | None:
    size = quantity(value, MEMORY)
    if size is not None and size < LEAST_MEMORY:
        raise click.BadParameter(f"no log can be read in less than {LEAST_MEMORY // 10**6}MB")
    return None if size is None else int(size)


def _time(_ctx: click.Context, _param: click.Parameter, value: str) -> float | None:
    return quantity(value, TIME)


def _bounds(max_memory: int | None, max_time: float | None) -> Bounds:
    from flysid.ingest.lake.workers import Bounds

    return Bounds(max_memory, max_time)


_MEMORY = click.option(
    "--max-memory",
    cls=Own,
    default="4GB",
    show_default=True,
    metavar="SIZE",
    envvar="FLYSID_MAX_MEMORY",
    callback=_memory,
    help="Memory limit per log, or none; also FLYSID_MAX_MEMORY.",
)
_TIME = click.option(
    "--max-time",
    cls=Own,
    default="10min",
    show_default=True,
    metavar="TIME",
    envvar="FLYSID_MAX_TIME",
    callback=_time,
    help="Time limit per log, or none; also FLYSID_MAX_TIME.",
)
bounds_options = gather("bounds", _bounds, _MEMORY, _TIME)
"""--max-memory and --max-time; the verb takes them as the `bounds` of a reader."""
bounds_options = gather("bounds", _bounds, _MEMORY, _TIME)
"""--max-memory and --max-time; the verb takes them as the `bounds` of a reader."""
