"""Findings in words, as doubts of a channel, and as corrections of a recipe."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from flysid.errors import UsageError
from flysid.escaping import toml_document
from flysid.ingest.align.doubts import Doubt
from flysid.ingest.align.recipe import Recipe, Source, load_recipe, recipe_text
from flysid.ingest.align.signals import Log, find_source
from flysid.ingest.formats.common.units import factor
from flysid.ingest.kinematics.compatibility import (
    AGAINST,
    FLY,
    Compatibility,
    Correction,
    InstrumentCheck,
    Parameter,
    compatibility,
    corrections_of,
    quantities,
)

SHOWN: dict[str, tuple[str, str]] = {"s": ("s", "ms"), "m": ("m", "cm"), "rad/s": ("rad/s", "deg/s")}
"""Unit -> itself as recipes spell it, and the one that people read."""
SIDES = {
    "forward": ("ahead of", "behind"),
    "right": ("to the right of", "to the left of"),
    "down": ("below", "above"),
}
NEXT = "correct them at the source, or in the recipe: 'flysid doctor --kinematics' with --correct"


def sentence(parameter: Parameter, comparison: InstrumentCheck) -> str:
    """What a parameter means, with its interval, no full stop.

    >>> told = Parameter("velocity", "v_east", "scale", 1.05, 0.005, 1.0, 0.01, "", True)
    >>> sentence(told, Comparison("velocity", {"v_east": ("vehicle_local_position", "vy")}))
    "velocity east (vehicle_local_position.vy) is 1.05 [1.04, 1.06] times the position's rate"
    """
    number = _number(parameter)
    against = AGAINST[parameter.instrument]
    if not parameter.signal:
        stream = (
            next(iter(comparison.sources.get(comparison.axes[0], ("", ""))), "") if comparison.axes else ""
        )
        whose = f"{_name(parameter.instrument)} ({stream})" if stream else _name(parameter.instrument)
        if parameter.kind == "lag":
            behind = "behind" if parameter.value >= 0.0 else "ahead of"
            return f"{whose} is {number} {behind} {against}"
        side = SIDES[parameter.kind.removeprefix("arm ")][parameter.value < 0.0]
        return f"{whose} sits {number} {side} what the velocity is of"
    stream, column = comparison.sources[parameter.signal]
    whose = f"{quantities().signals[parameter.signal].description} ({stream}.{column})"
    if parameter.foreign:
        return f"{whose} does not follow {against}: {number} times it"
    if parameter.kind == "scale":
        return f"{whose} is {number} times {against}"
    where = " at its mean" if parameter.kind == "offset" else ""
    return f"{whose} reads {number} too much{where}, against {against}"


def _name(instrument: str) -> str:
    return {"heading_velocity": "velocity along the heading"}.get(instrument, instrument)


def _number(parameter: Parameter) -> str:
    """Value and 95 % interval in a unit for people; of what has words for its sign, its size."""
    unit = SHOWN.get(parameter.unit, (parameter.unit, parameter.unit))
    gain = factor(unit[0], unit[1]) if unit[0] != unit[1] else 1.0
    low, high = parameter.interval
    value = parameter.value
    if not parameter.signal and value < 0.0:
        value, low, high = -value, -high, -low
    digits = max(0, 1 - int(np.floor(np.log10(max(high - low, 1e-12) * gain))))
    numbers = [f"{gain * v:.{digits}f}" for v in (value, low, high)]
    return f"{numbers[0]} [{numbers[1]}, {numbers[2]}] {unit[1]}".rstrip()


def lines(found: Compatibility) -> Iterator[str]:
    """A log's kinematics for people: what was compared, then what was found."""
    for comparison in found.comparisons:
        title = f"{_name(comparison.instrument)} against {AGAINST[comparison.instrument]}"
        if comparison.reason:
            if not comparison.reason.startswith("not logged"):
                yield f"{title}: not compared: {comparison.reason}"
            continue
        wrong = [p for p in comparison.parameters if p.found]
        cut = f", {comparison.cut_s:.0f} s around jumps left out" if comparison.cut_s >= 1.0 else ""
        verdict = "agree" if not wrong else f"{len(wrong)} of {len(comparison.parameters)} numbers differ"
        yield f"{title}: {comparison.seconds:.0f} s compared{cut}: {verdict}"
        yield from (f"  {sentence(parameter, comparison)}" for parameter in wrong)
        for axis in comparison.still:
            yield (
                f"  {quantities().signals[axis].description} did not move enough for a scale; fly {FLY[axis]}"
            )


def as_document(found: Compatibility) -> dict[str, Any]:
    """All that was estimated, for JSON."""
    return {
        "findings": len(found.findings),
        "comparisons": [
            {
                "instrument": c.instrument,
                "against": AGAINST[c.instrument],
                "reason": c.reason,
                "seconds": c.seconds,
                "left_out_s": c.cut_s,
                "still": list(c.still),
                "numbers": [
                    {
                        "signal": p.signal,
                        "kind": p.kind,
                        "value": p.value,
                        "interval": list(p.interval),
                        "unit": p.unit,
                        "found": p.found,
                        "words": sentence(p, c),
                    }
                    for p in c.parameters
                ],
            }
            for c in found.comparisons
        ],
    }


def nothing_to_compare(found: Compatibility) -> str:
    """Why nothing could be compared; "" where something was."""
    if any(not c.reason for c in found.comparisons):
        return ""
    reasons = [f"{_name(c.instrument)}: {c.reason}" for c in found.comparisons]
    return "nothing to compare: " + "; ".join(reasons)


class Instruments:
    """The first flights of a folder, compared once, at the first use, for all channels of a fit."""

    def __init__(self, logs: Sequence[Log], *, most: int = 5) -> None:
        """`most`: flights of a channel whose instruments are compared before a fit."""
        self._logs = logs[:most]
        self._found: dict[int, Compatibility] = {}

    def doubts(self, recipe: Recipe, channel: str) -> tuple[Doubt, ...]:
        """What is wrong with the fields that a channel uses."""
        axes = [axis for c in quantities().channels.values() for axis in c.outputs]
        said: dict[str, None] = {}
        looked = 0
        for number, log in enumerate(self._logs):
            used = {place for name in recipe.signals_of(channel) for place in _places(recipe, name, log)}
            if not any(used & _places(quantities(), axis, log) for axis in axes):
                continue
            looked += 1
            if number not in self._found:
                self._found[number] = compatibility(log)
            for comparison in self._found[number].comparisons:
                for p in comparison.parameters:
                    own = [p.signal] if p.signal else comparison.axes
                    if p.found and any(used & _places(quantities(), axis, log) for axis in own):
                        said[sentence(p, comparison)] = None
        where = f"of {looked} flights that were compared, one: " if looked > 1 else ""
        return tuple(Doubt("kinematics", f"{where}{words}", NEXT) for words in said)


def _place(recipe: Recipe, signal: str, log: Log) -> tuple[str, tuple[str, ...]] | None:
    """Stream and fields that a signal comes from."""
    found = find_source(recipe.signals[signal].sources, log)
    return (found[1], found[0].fields) if found else None


def _places(recipe: Recipe, signal: str, log: Log) -> set[tuple[str, str]]:
    """Stream and field of all that a signal comes from."""
    found = _place(recipe, signal, log)
    return {(found[0], name) for name in found[1]} if found else set()


def corrected_recipe(name: str, log: Log, found: Compatibility) -> tuple[str, list[str]]:
    """A recipe's text with a log's findings taken out of its signals, and what was done, one line each.

    Raises UsageError: none of the recipe's fields is at fault.
    """
    text, _ = recipe_text(name)
    document = tomllib.loads(text)
    recipe = load_recipe(name)
    by_place = {}
    for comparison in found.comparisons:
        for signal, correction in corrections_of(comparison.parameters).items():
            by_place[_place(quantities(), signal, log)] = (signal, correction)
    done = []
    for signal, spec in recipe.signals.items():
        place = _place(recipe, signal, log)
        if place not in by_place or place is None:
            continue
        axis, correction = by_place[place]
        source = find_source(spec.sources, log)
        assert source is not None  # its place was found
        index = spec.sources.index(source[0])
        theirs = quantities().signals[axis]
        own = find_source(theirs.sources, log)
        assert own is not None
        if source[0].transform != "none":
            continue
        change = _change(correction, source[0], own[0], factor(theirs.unit, spec.unit))
        document["signals"][signal]["sources"][index] |= change
        done.append(f"{signal}: " + ", ".join(f"{key} = {value:.6g}" for key, value in change.items()))
    if not done:
        raise UsageError(
            f"no field of recipe {name!r} was found at fault",
            hint="flysid doctor LOG --kinematics says what was compared",
        )
    return toml_document(document), done


def _change(correction: Correction, source: Source, own: Source, gain: float) -> dict[str, Any]:
    """Keys of a source that take a correction out. `gain` converts the kinematics' unit to the signal's."""
    sign = source.scale / own.scale  # of the recipe's axis against the kinematics'
    return {
        "scale": source.scale / correction.scale,
        "offset": source.offset - sign * gain * (correction.bias / correction.scale),
        "lag_s": source.lag_s + correction.lag_s,
    }
