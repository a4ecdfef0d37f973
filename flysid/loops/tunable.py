"""The settings of a rate loop that a design may move: which they are, and what they are by a factor."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from flysid.errors import UsageError
from flysid.laws.described import Law, blackbox_law, parameter_law
from flysid.loops.new_settings import value_of
from flysid.loops.parameter_laws import px4_law

FACTOR = 2.0
"""By which a setting may change from one flight to the next, up and down."""
DIGITS = 3
"""Of a parameter that is no whole number."""
PLACES = {0: "p", 1: "i", 2: "d", "boost_other": "d"}
"""Where a header states the terms -> the term that a setting belongs to."""
LOWPASSES = ("lowpass_1", "lowpass_2")


@dataclass(frozen=True)
class Setting:
    """One setting.

    `name`: of the command line, or of the parameter.
    `part`: p, i, d or filters; what moves together.
    `value`: the present one.
    `whole`: only whole numbers.
    """

    name: str
    part: str
    value: float
    whole: bool

    def times(self, factor: float) -> str:
        """The value by a factor, rounded towards the present one.

        >>> Setting("p_roll", "p", 45.0, True).times(1.29), Setting("P", "p", 0.135, False).times(0.8)
        ('58', '0.108')
        """
        new = factor * self.value
        step = 1.0 if self.whole else 10.0 ** (math.floor(math.log10(abs(new))) - DIGITS + 1)
        slack = 1e-9 if factor >= 1.0 else -1e-9
        steps = (math.floor if factor >= 1.0 else math.ceil)(new / step + slack)
        return f"{steps * step:.{DIGITS}g}" if not self.whole else f"{steps}"


def list_tunable(stated: Mapping[str, Any], axis: str) -> list[Setting]:
    """The gains and D filters of an axis that are in use.

    `stated`: a blackbox header's settings, or parameters by name.
    Raises UsageError: a value is no number.
    """
    if "Firmware revision" in stated:
        return _of_header(blackbox_law(stated["Firmware revision"]), stated, axis)
    law = own_law(stated)
    own = law.part("axes")[axis]
    roles = {"p": "p", "i": "i", "d": "d", "slope_hz": "filters"}
    names = {law.name_of(role, axis=own): part for role, part in roles.items()}
    values = {name: float(f"{stated.get(name, 0.0):.6g}") for name in names}  # logs keep single precision
    return [Setting(name, part, values[name], False) for name, part in names.items() if values[name] > 0.0]


def own_law(stated: Mapping[str, float]) -> Law:
    """The law of an autopilot that states parameters."""
    return px4_law(stated) if any(name.startswith("MC_") for name in stated) else parameter_law("arducopter")


def _of_header(law: Law, stated: Mapping[str, str], axis: str) -> list[Setting]:
    slopes = axis in law.part("derivative")["axes"]
    newest = {where: stem for stem, where in law.part("cli").items() if where in PLACES}  # one name a place
    names = {f"{stem}_{axis}": PLACES[where] for where, stem in newest.items() if slopes or where in (0, 1)}
    found = _stated(names, stated)
    if any(own.part == "d" for own in found):
        found += _stated(dict.fromkeys(_filters(law, stated), "filters"), stated)
    return found


def _stated(names: Mapping[str, str], stated: Mapping[str, str]) -> list[Setting]:
    """Those of names and parts that a header states, and that are not 0."""
    found = []
    for name, part in names.items():
        try:
            value = value_of(stated, name)
        except UsageError:  # a version without it
            continue
        if value > 0.0:
            found.append(Setting(name, part, value, True))
    return found


def _filters(law: Law, stated: Mapping[str, str]) -> list[str]:
    """Names of the D low-passes: of the first, its ends where it moves."""
    pairs = {tuple(where): name for name, where in law.part("pairs").items()}
    moving = [name for (role, _), name in pairs.items() if role == "lowpass_1_moving"]
    moves = moving and _states(stated, moving[0])
    found = list(moving) if moves else []
    for role in LOWPASSES[1 if moves else 0 :]:
        found += [name for name in law.names.get(role, ()) if name in stated][:1]
    return found


def _states(stated: Mapping[str, str], name: str) -> bool:
    """Whether a setting is stated, and not 0."""
    try:
        return value_of(stated, name) > 0.0
    except UsageError:
        return False
