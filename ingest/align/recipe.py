"""Recipes: which fields of a log are the inputs and outputs of a channel, in which unit and sign.

A recipe is a TOML file. `[signals.NAME]` says where a signal comes from and what a user wants to see;
`[channels.NAME]` says which signals are inputs and which are outputs:

    name = "my-copter"
    rate_hz = "auto"                      # or a number; auto: the slowest source of the channel

    [signals.theta_in]
    unit = "deg"                          # converted from the unit the log states
    hold = "zero"                         # a command: zero-order hold; "linear" (default): a state
    sources = [                           # tried in order; the first that the log holds is taken
      { stream = "ATTITUDE_TARGET", field = "q", transform = "pitch", scale = -1.0 },
      { stream = "/ardrone/command", field = "theta_in" },
    ]

    [channels.longitudinal]
    inputs = ["theta_in"]
    outputs = ["v_x"]

An unknown key is a RecipeError that names the nearest known one.
"""

from __future__ import annotations

import dataclasses
import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal, cast

import msgspec

from flysid.errors import RecipeError
from flysid.files import remedy_unread, why_unread
from flysid.ingest.align.transforms import TRANSFORMS
from flysid.ingest.formats.common.units import is_known
from flysid.offers import Offer, offers
from flysid.showing import one_of

QUICK = "quick"
"""The name of a recipe that is made of fields, which nobody has named."""
SUFFIX = ".toml"
OWN = "flysid.ingest.align"
FOLDER = "recipes"
ENTRY_POINTS = "flysid.recipes"


@dataclass(frozen=True)
class Source:
    """One place a signal may come from.

    Attributes
    ----------
    stream : key of a stream, or its message name; of several the autopilot's is taken.
    field : a column, or the columns that the transform needs, e.g. the parts of a quaternion.
    transform : a name of `flysid.ingest.align.transforms.TRANSFORMS`.
    unit : what the values are in where the log does not say.
    scale, offset : signal = scale * value + offset, after conversion to the signal's unit.
    yaw : source of the heading, for transforms into the heading frame.
    where : rows are kept where these columns have these values, e.g. {"C": 0} for one estimator core.
    time : a column that holds the sample's own time, e.g. `timestamp_sample`; `time_ns` when empty.
    row_period_s : seconds from row to row, for a table without a time column, and for nothing else.
    lag_s : age of a value when it is stamped; it is taken off the stamps.
    """

    stream: str
    field: str | tuple[str, ...]
    transform: str = "none"
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    yaw: Source | None = None
    where: dict[str, int | float | str] = dataclasses.field(default_factory=dict)
    time: str = ""
    row_period_s: float | None = None
    lag_s: float = 0.0

    @property
    def fields(self) -> tuple[str, ...]:
        return (self.field,) if isinstance(self.field, str) else self.field


@dataclass(frozen=True)
class SignalSpec:
    """A signal: its unit, where it comes from, and how it is brought onto the grid.

    Attributes
    ----------
    unit : physical unit wanted.
    sources : alternatives, tried in order.
    hold : "zero" for commands (the last value counts until the next), "linear" for states.
    max_gap_s : a longer pause in the source cuts the segment; None: relative to its own period. Write
        `inf` for commands that are only sent when they change.
    max_rate : fastest change that is physically possible, in unit per second; samples that jump away from
        their neighbours by more are dropped, which cuts where several follow one another.
    limits : lowest and highest value the actuator or controller allows; segments are marked with the share
        of samples that stand there.
    description : what it is, for people.
    """

    unit: str
    sources: tuple[Source, ...]
    hold: Literal["zero", "linear"] = "linear"
    max_gap_s: float | None = None
    max_rate: float | None = None
    limits: tuple[float, float] | None = None
    description: str = ""


@dataclass(frozen=True)
class ChannelSpec:
    """Inputs and outputs of one channel, by the names of signals.

    `reference` names signals that drive a feedback loop around the channel from outside: a chirp, a setpoint.
    They are no inputs; `flysid tf` measures the channel's response through them. `reference_at` tells where
    the one reference enters: "input", added to what the controller gives, or "setpoint", before a controller
    that sees the difference alone; margins need it. `min_rate_hz` is the rate
    below which the channel's dynamics cannot be seen, and `remedy` what to set on the vehicle to log faster;
    both serve the suggestions.
    `shows` and `hides` tell which changes of the vehicle this channel shows, and which it does not and where
    they would be seen; both serve the comparison of a fleet.
    `stick_modes` names the flight modes in which the pilot's stick commands the input, directly or as an
    angle. In every other one a loop around velocity or position does, which answers the vehicle: it holds no
    step response. Empty: not known.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    reference: tuple[str, ...] = ()
    reference_at: Literal["", "input", "setpoint"] = ""
    description: str = ""
    min_rate_hz: float = 0.0
    remedy: str = ""
    shows: str = ""
    hides: str = ""
    stick_modes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Condition:
    """Samples count only while a value is in bounds, e.g. while the vehicle is airborne.

    Conditions of one name are alternatives: the first that the log has a source for counts. All names must
    hold at once.

    Attributes
    ----------
    name : what it means, e.g. "airborne".
    sources : alternatives, tried in order.
    unit : unit of `above` and `below`; "" compares the values as they are logged.
    above, below : exclusive bounds.
    any_of : the value (or its enumeration's name) must be one of these; for modes and flags.
    has_bits : all of these bits must be set, for bit fields (128: armed in HEARTBEAT.base_mode).
    set_by, cleared_by : for events that are logged once: it holds from one of these values to one of those;
        others change nothing, and before the first it was the other way round.
    margin_s : cut away this long at both ends of every interval in which the condition holds.
    required : without a source the flight is refused; otherwise the condition is left out with a remark.
    channels : the channels that it is about; empty: all.
    """

    name: str
    sources: tuple[Source, ...]
    unit: str = ""
    above: float | None = None
    below: float | None = None
    any_of: tuple[int | float | str, ...] = ()
    has_bits: int = 0
    set_by: tuple[int | float | str, ...] = ()
    cleared_by: tuple[int | float | str, ...] = ()
    margin_s: float = 0.0
    required: bool = False
    channels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Label:
    """A state of the vehicle that marks segments, e.g. its mode; where `cut`, its changes end a segment."""

    name: str
    sources: tuple[Source, ...]
    cut: bool = True


@dataclass(frozen=True)
class ClockSpec:
    """Streams that another recorder stamped with its own clock, e.g. motion capture.

    Attributes
    ----------
    name : the recorder.
    streams : the streams on its clock.
    other, reference : one quantity as that recorder and as the vehicle measured it, in `unit`.
    max_offset_s : largest offset to look for.
    drift : estimate a drift as well as an offset.
    enabled : false takes the stamps as they are.
    """

    name: str
    streams: tuple[str, ...]
    other: Source
    reference: Source
    unit: str = ""
    max_offset_s: float = 5.0
    drift: bool = True
    enabled: bool = True


@dataclass(frozen=True)
class Recipe:
    """Signals and channels, and how to cut and sample them.

    Attributes
    ----------
    rate_hz : rate of the grid; "auto": that of the slowest source of each channel.
    max_rate_hz : "auto" goes no higher.
    min_segment_s : shorter segments are dropped; None: 20 samples.
    max_segment_s : longer segments are cut.
    antialias : filter (all signals of a channel alike) where a source is much faster than the grid.
    """

    name: str
    signals: dict[str, SignalSpec]
    channels: dict[str, ChannelSpec]
    description: str = ""
    rate_hz: float | Literal["auto"] = "auto"
    max_rate_hz: float = float("inf")
    min_segment_s: float | None = None
    max_segment_s: float = float("inf")
    antialias: bool = True
    conditions: tuple[Condition, ...] = ()
    clocks: tuple[ClockSpec, ...] = ()
    labels: tuple[Label, ...] = ()

    @property
    def title(self) -> str:
        """What a message calls it: nobody has named one that is made of fields."""
        return "the recipe of these fields" if self.name == QUICK else f"recipe {self.name!r}"

    def channel(self, name: str) -> ChannelSpec:
        """A channel by name; RecipeError names those that there are otherwise, and the nearest one."""
        if name in self.channels:
            return self.channels[name]
        raise RecipeError(f"{self.title} has no channel {name!r}", hint=one_of(list(self.channels), name))

    def chosen(self, wanted: Sequence[str]) -> tuple[str, ...]:
        """The channels that are wanted, in the recipe's order, or all; raises as `channel`."""
        for name in wanted:
            self.channel(name)
        return tuple(name for name in self.channels if not wanted or name in wanted)

    def signals_of(self, channel: str) -> tuple[str, ...]:
        """Names of the signals of a channel, inputs first; without its references."""
        spec = self.channel(channel)
        return (*spec.inputs, *spec.outputs)

    def conditions_of(self, channel: str) -> tuple[Condition, ...]:
        """The conditions that are about a channel."""
        return tuple(c for c in self.conditions if not c.channels or channel in c.channels)

    def with_references(self) -> Recipe:
        """The recipe with every channel's references as its last inputs."""
        channels = {
            name: dataclasses.replace(c, inputs=(*c.inputs, *(r for r in c.reference if r not in c.inputs)))
            for name, c in self.channels.items()
        }
        return dataclasses.replace(self, channels=channels)


def shipped_recipes() -> tuple[str, ...]:
    """Names of the recipes that come with flysid, and with installed packages.

    Raises UsageError: an installed package offers a recipe under a name that is taken.
    """
    return tuple(sorted((*_own_recipes(), *_offered_recipes())))


def _own_recipes() -> tuple[str, ...]:
    folder = resources.files(OWN) / FOLDER
    return tuple(p.name[: -len(SUFFIX)] for p in folder.iterdir() if p.name.endswith(SUFFIX))


def _offered_recipes() -> dict[str, Offer]:
    """By name the entry points of installed packages, each the module beside which NAME.toml lies."""
    own = _own_recipes()
    found: dict[str, Offer] = {}
    for offer in offers(ENTRY_POINTS):
        if offer.name in own or offer.name in found:
            raise offer.refusal(f"the name {offer.name!r} is taken")
        found[offer.name] = offer
    return found


def load_recipe(name: str | Path) -> Recipe:
    """A shipped recipe by name, or a user's own by path (ends with .toml or holds a folder).

    Raises RecipeError: no such recipe, not TOML, an unknown key, a wrong type, an inconsistent entry.
    """
    text, where = recipe_text(str(name))
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise RecipeError(f"not TOML: {error}", path=where) from error
    return parse_recipe(document, where)


def _offered_text(offer: Offer) -> str:
    """The recipe of an installed package."""
    try:
        return (resources.files(offer.load()) / f"{offer.name}{SUFFIX}").read_text("utf-8")
    except (OSError, UnicodeDecodeError, TypeError) as error:
        raise offer.refusal(f"{offer.name}{SUFFIX} is not beside {offer.value}, or not a text") from error


def parse_recipe(document: Mapping[str, Any], where: str = "") -> Recipe:
    """A recipe from a TOML document; `where` names it in errors."""
    _check_keys(document, Recipe, "", where)
    try:
        recipe = msgspec.convert(document, Recipe)
    except msgspec.ValidationError as error:
        raise RecipeError(_in_words(str(error)), path=where) from error
    _check_sense(recipe, where)
    return recipe


def recipe_text(name: str) -> tuple[str, str]:
    """The text of a shipped recipe or of a file, and what to call it in errors; raises RecipeError."""
    if name in _own_recipes():
        return (resources.files(OWN) / FOLDER / f"{name}{SUFFIX}").read_text("utf-8"), name
    if name in (offered := _offered_recipes()):
        return _offered_text(offered[name]), f"{name} of the package {offered[name].package}"
    path = Path(name)
    if path.suffix != SUFFIX and path.name == name:
        raise RecipeError(
            f"no recipe {name!r}", hint=_nearest(name, shipped_recipes()) + ", or the path of a .toml file"
        )
    try:
        return path.read_text("utf-8"), name
    except OSError as error:
        raise RecipeError(
            f"cannot be read: {why_unread(error)}", path=name, hint=remedy_unread(error)
        ) from error
    except UnicodeDecodeError as error:
        raise RecipeError(
            "not a text file in UTF-8",
            path=name,
            byte=error.start,
            hint="a recipe is a .toml file: flysid recipes lists those that come with flysid",
        ) from error


_KINDS = {
    "array": "a list",
    "bool": "true or false",
    "float": "a number",
    "int": "a whole number",
    "object": "a table",
    "str": "text",
}


def _in_words(told: str) -> str:
    """What msgspec says of a wrong value, in TOML's words."""
    said, _, place = told.partition(" - at ")
    place = place.strip("`").removeprefix("$").removeprefix(".").replace("[...]", ".NAME")
    at = f" in [{place}]" if place else ""
    if lacking := re.fullmatch("Object missing required field `(.+)`", said):
        return f"{lacking[1]!r} is missing{at}"
    if kinds := re.fullmatch("Expected `(.+)`, got `(.+)`", said):
        wanted, got = (
            " or ".join(_KINDS.get(k, k) for k in one.split(" | ") if k != "null") for one in kinds.groups()
        )
        return f"{place or 'a recipe'} must be {wanted}, not {got}"
    return f"wrong value: {said}{at}"


def _nearest(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    return ", ".join(near) if near else "one of " + ", ".join(sorted(known))


# What lies below a key: (kind of container, type of its entries).
_BELOW: Mapping[type, Mapping[str, tuple[str, type]]] = {
    Recipe: {
        "signals": ("table", SignalSpec),
        "channels": ("table", ChannelSpec),
        "conditions": ("list", Condition),
        "clocks": ("list", ClockSpec),
        "labels": ("list", Label),
    },
    SignalSpec: {"sources": ("list", Source)},
    Condition: {"sources": ("list", Source)},
    Label: {"sources": ("list", Source)},
    Source: {"yaw": ("one", Source)},
    ClockSpec: {"other": ("one", Source), "reference": ("one", Source)},
}


def _check_keys(value: object, kind: type, place: str, where: str) -> None:
    """Raise RecipeError for the first key that `kind` does not have, naming the nearest one it has."""
    if not isinstance(value, Mapping):
        return  # wrong types are msgspec's to report
    known = [f.name for f in dataclasses.fields(kind)]
    for key in value:
        if key not in known:
            at = f" in [{place}]" if place else ""
            raise RecipeError(f"unknown key {key!r}{at}", path=where, hint=_nearest(key, known))
    for key, (container, entry) in _BELOW.get(kind, {}).items():
        for label, item in _entries(value.get(key), container):
            _check_keys(item, entry, f"{place}.{key}{label}".lstrip("."), where)


def _entries(value: object, container: str) -> list[tuple[str, object]]:
    if container == "table" and isinstance(value, Mapping):
        return [(f".{name}", item) for name, item in value.items()]
    if container == "list" and isinstance(value, list):
        return [(f"[{i}]", item) for i, item in enumerate(cast("list[object]", value))]
    return [("", value)] if container == "one" else []


def _unknown_unit(unit: str, name: str, where: str) -> RecipeError:
    return RecipeError(f"unknown unit {unit!r} of {name!r}", path=where, hint="e.g. deg, rad, m/s, m, deg/s")


def _check_sense(recipe: Recipe, where: str) -> None:
    """What types cannot say: names refer to something, units are known, numbers are positive."""
    if recipe.rate_hz != "auto" and not 0 < recipe.rate_hz < 1e6:
        raise RecipeError(f"rate_hz must be positive, not {recipe.rate_hz}", path=where)
    for key in ("max_rate_hz", "max_segment_s"):
        if not getattr(recipe, key) > 0:
            raise RecipeError(f"{key} must be positive, not {getattr(recipe, key)}", path=where)
    if recipe.min_segment_s is not None and not recipe.min_segment_s >= 0:
        raise RecipeError(f"min_segment_s is negative: {recipe.min_segment_s}", path=where)
    if not recipe.channels:
        raise RecipeError("a recipe needs at least one [channels.NAME]", path=where)
    for name, channel in recipe.channels.items():
        if not channel.inputs or not channel.outputs:
            raise RecipeError(f"channel {name!r} needs inputs and outputs", path=where)
        for signal in (*recipe.signals_of(name), *channel.reference):
            if signal not in recipe.signals:
                raise RecipeError(
                    f"channel {name!r} uses signal {signal!r}, which has no [signals.{signal}]",
                    path=where,
                    hint=_nearest(signal, list(recipe.signals)),
                )
    for clock in recipe.clocks:
        _check_source(clock.other, clock.name, where)
        _check_source(clock.reference, clock.name, where)
    for label in recipe.labels:
        for source in label.sources:
            _check_source(source, label.name, where)
    for condition in recipe.conditions:
        _check_condition(condition, recipe, where)
    named: list[tuple[str, SignalSpec | Condition]] = [*recipe.signals.items()]
    for name, spec in [*named, *((c.name, c) for c in recipe.conditions)]:
        if not is_known(spec.unit):
            raise _unknown_unit(spec.unit, name, where)
        if not spec.sources:
            raise RecipeError(f"{name!r} has no sources", path=where)
        for source in spec.sources:
            _check_source(source, name, where)


def _check_condition(condition: Condition, recipe: Recipe, where: str) -> None:
    kinds = {
        "above, below": condition.above is not None or condition.below is not None,
        "any_of": bool(condition.any_of),
        "has_bits": bool(condition.has_bits),
        "set_by, cleared_by": bool(condition.set_by or condition.cleared_by),
    }
    if sum(kinds.values()) != 1:
        raise RecipeError(
            f"condition {condition.name!r} must say one thing that holds, not {sum(kinds.values())}",
            path=where,
            hint="one of " + "; ".join(kinds),
        )
    for name in condition.channels:
        if name not in recipe.channels:
            raise RecipeError(
                f"condition {condition.name!r} is about channel {name!r}, which is not there",
                path=where,
                hint=_nearest(name, list(recipe.channels)),
            )


def _check_source(source: Source, name: str, where: str) -> None:
    transform = TRANSFORMS.get(source.transform)
    if transform is None:
        raise RecipeError(
            f"unknown transform {source.transform!r} of {name!r}",
            path=where,
            hint=_nearest(source.transform, list(TRANSFORMS)),
        )
    if len(source.fields) not in transform.field_counts:
        raise RecipeError(
            f"transform {source.transform!r} of {name!r} takes "
            f"{' or '.join(map(str, transform.field_counts))} fields, not {len(source.fields)}",
            path=where,
        )
    if transform.needs_yaw != (source.yaw is not None):
        verb = "needs" if transform.needs_yaw else "has no use for"
        raise RecipeError(f"transform {source.transform!r} of {name!r} {verb} a yaw source", path=where)
    if not is_known(source.unit):
        raise _unknown_unit(source.unit, name, where)
    if source.row_period_s is not None and not 0 < source.row_period_s < float("inf"):
        raise RecipeError(f"row_period_s of {name!r} must be positive, not {source.row_period_s}", path=where)
    if not abs(source.lag_s) < 1e6:
        raise RecipeError(f"lag_s of {name!r} must be seconds, not {source.lag_s}", path=where)
    if source.scale == 0.0:
        raise RecipeError(f"scale of {name!r} must not be 0", path=where)
    if source.yaw is not None:
        _check_source(source.yaw, f"{name}.yaw", where)
