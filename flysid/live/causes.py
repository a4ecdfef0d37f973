"""Possible causes of an alarm, by the kind of output that changed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from flysid.dataset import Signal

EFFORT = re.compile(r"thrust|throttle|torque|thr\b|tho\b|motor|rpm|power|current", re.IGNORECASE)
RATES = ("deg/s", "rad/s")
SPEEDS = ("m/s", "cm/s", "mm/s")


@dataclass(frozen=True)
class Meaning:
    """What an output is, what its rise and its fall may come from, and whether it shows what stays."""

    kind: str
    rise: tuple[str, ...]
    fall: tuple[str, ...]
    shows_what_stays: bool = False


LIFT = Meaning(
    "effort",
    ("more mass", "less voltage", "worn or damaged propellers", "sinking air"),
    ("less mass (a load was lost)", "ground effect", "rising air"),
    shows_what_stays=True,
)
_TURNING = (
    "a motor or propeller that gives less or more than the others",
    "a centre of gravity that moved",
    "changed gains",
)
TURNING = Meaning("turning", _TURNING, _TURNING, shows_what_stays=True)
_SIDEWAYS = ("wind", "drag that changed (something hangs down or broke off)", "a trim of the attitude sensor")
SIDEWAYS = Meaning("horizontal speed", _SIDEWAYS, _SIDEWAYS)
CLIMB = Meaning(
    "climb",
    ("less mass at this moment", "rising air"),
    ("more mass at this moment", "no thrust left", "sinking air"),
)
_TILT = (
    "a weaker actuator",
    "a centre of gravity that moved",
    "changed gains",
    "a trim of the attitude sensor",
)
TILT = Meaning("attitude", _TILT, _TILT)
_ANY = ("the vehicle, its load or a sensor changed",)
ANYTHING = Meaning("output", _ANY, _ANY)


def meaning_of(output: Signal, inputs: Sequence[Signal]) -> Meaning:
    """What is known of an output by its name, its unit and what drives it."""
    if EFFORT.search(output.name):
        return LIFT
    if output.unit in RATES and any(EFFORT.search(s.name) for s in inputs):
        return TURNING
    if output.unit in RATES or output.unit in ("deg", "rad"):
        return TILT
    if output.unit in SPEEDS:
        return CLIMB if re.search(r"z|climb|vert", output.name, re.IGNORECASE) else SIDEWAYS
    return ANYTHING


def likely(meaning: Meaning, shift: float) -> str:
    """Causes of a shift, and that one channel cannot tell them apart."""
    causes = meaning.rise if shift > 0.0 else meaning.fall
    if len(causes) == 1:
        return causes[0]
    return f"{', '.join(causes[:-1])} or {causes[-1]}; this channel cannot tell which"


def likely_of_effort(signal: Signal, output: Meaning, beyond: float) -> str:
    """Causes of an input that stays above (`beyond` > 0) or below what was flown; "" if it is no effort."""
    if not EFFORT.search(signal.name):
        return ""
    return likely(LIFT if output is CLIMB else output, beyond)


def visibility(channel: str, output: Signal, inputs: Sequence[Signal]) -> str:
    """What faults a channel can show at all."""
    meaning = meaning_of(output, inputs)
    pair = f"{channel}: {output.name} <- {', '.join(s.name for s in inputs)}"
    if meaning.shows_what_stays:
        return f"{pair}: shows faults as they occur and while they last"
    return f"{pair}: shows faults as they occur; the vehicle's own control hides lasting ones"
