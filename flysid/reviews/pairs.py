"""Which setpoint belongs to which measurement: the loops of a vehicle, from outside to inside.

Roll and pitch are paired by the shipped recipes, the rest by `tracking.toml` beside this module; a recipe of
the reader's own comes first.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

from flysid.dataset import FloatArray
from flysid.ingest.align.recipe import Recipe, load_recipe, parse_recipe
from flysid.loops.betaflight import IDLE_STICK
from flysid.reviews.logged import BoolArray, Column, LoggedFlight

OWN = "tracking"
YAW_SLOWER = 3.0


@dataclass(frozen=True)
class Loop:
    """One kind of loop.

    `key`, `title`: "rate", "rates".
    `unit`: of setpoint and measurement.
    `search_s`: the longest lag that is looked for.
    `channels`: axis -> name of the channel in a recipe.
    `recipes`: of other places than `tracking.toml`, the first that fits the log counts.
    `is_angle`: whether 359 and 1 degrees are 2 apart.
    """

    key: str
    title: str
    unit: str
    search_s: float
    channels: Mapping[str, str]
    recipes: tuple[str, ...] = ()
    is_angle: bool = False


LOOPS = (
    Loop("position", "position", "m", 4.0, {"north": "north", "east": "east", "up": "height"}),
    Loop("velocity", "velocity", "m/s", 2.0, {"north": "v_north", "east": "v_east", "up": "climb"}),
    Loop(
        "attitude",
        "attitude",
        "deg",
        1.0,
        {axis: axis for axis in ("roll", "pitch", "yaw")},
        ("ardupilot-attitude", "px4-attitude"),
        is_angle=True,
    ),
    Loop(
        "rate",
        "rates",
        "deg/s",
        0.5,
        {axis: f"{axis}_rate" for axis in ("roll", "pitch", "yaw")},
        ("ardupilot-rate", "px4-rates", "betaflight-rate"),
    ),
)
"""From outside to inside."""


@dataclass(frozen=True, eq=False)
class Pair:
    """A setpoint and what came of it.

    `loop`, `axis`: which.
    `setpoint`, `measured`: in the loop's unit.
    `min_rate_hz`: below which a log does not show how the loop follows.
    `remedy`: what to set on the vehicle to log faster; "" where the recipe does not say.
    """

    loop: Loop
    axis: str
    setpoint: Column
    measured: Column
    min_rate_hz: float
    remedy: str

    @property
    def rate_hz(self) -> float:
        """Of the slower of the two."""
        return min(self.setpoint.rate_hz, self.measured.rate_hz)

    @property
    def search_s(self) -> float:
        """The longest lag that is looked for: yaw is slower than roll and pitch."""
        return (YAW_SLOWER if self.axis == "yaw" else 1.0) * self.loop.search_s

    @property
    def fields(self) -> tuple[str, str]:
        """The evidence of every figure of this pair."""
        return self.setpoint.address, self.measured.address


recipe_of = cache(load_recipe)
"""A shipped recipe, read once."""


@cache
def tracking_recipe() -> Recipe:
    """The pairs that no shipped recipe holds."""
    text = files(__package__).joinpath(f"{OWN}.toml").read_text("utf-8")
    return parse_recipe(tomllib.loads(text), OWN)


def pairs(flight: LoggedFlight) -> Iterator[Pair]:
    """Every pair that a log holds, from outside to inside; none of a setpoint that is nothing but zero."""
    for loop in LOOPS:
        for axis, channel in loop.channels.items():
            found = _pair(flight, loop, axis, channel)
            if found is not None:
                yield found


def _pair(flight: LoggedFlight, loop: Loop, axis: str, channel: str) -> Pair | None:
    own = () if flight.recipe is None else (flight.recipe,)
    for recipe in (*own, *map(recipe_of, loop.recipes), tracking_recipe()):
        spec = recipe.channels.get(channel)
        if spec is None:
            continue
        setpoint = flight.signal(replace(recipe.signals[spec.inputs[0]], unit=loop.unit))
        if setpoint is None or not setpoint.values.any():
            continue  # MAVLink fills what is not commanded with zeros
        measured = flight.signal(replace(recipe.signals[spec.outputs[0]], unit=loop.unit))
        if measured is not None and len(setpoint) > 1 and len(measured) > 1:
            return Pair(loop, axis, setpoint, measured, spec.min_rate_hz, spec.remedy)
    return None


def in_control(flight: LoggedFlight) -> Callable[[FloatArray], BoolArray]:
    """Whether at times (n,) the vehicle flies and its controllers have a say: not at idle throttle."""
    throttle = flight.quantity("main.rcCommand[3]", unit="us")

    def counts(time_s: FloatArray) -> BoolArray:
        flying = flight.flying(time_s)
        return flying if throttle is None else flying & (throttle.held(time_s) > IDLE_STICK)

    return counts
