"""Rate controllers of PX4 and ArduPilot, from the parameters that a log states.

The laws are tables, `flysid/laws`; they count in rad/s and in shares of the output, here in deg/s and
thousandths.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flysid.errors import DataError
from flysid.laws.described import Law, Version, parameter_law
from flysid.loops.controller import THOUSANDTHS, Controller
from flysid.loops.stages import Notches

RELEASE = "ver_sw_release"
"""PX4's release in a ULog: major, minor and patch, a byte each."""
UNIT = np.pi / 180.0 * THOUSANDTHS
"""Thousandths to a deg/s for a gain of shares to a rad/s."""


def px4_law(stated: Mapping[str, float]) -> Law:
    """PX4's law of the release where the log names it; else the last one."""
    release = int(stated.get(RELEASE, 0.0))
    version: Version | None = (release >> 24 & 0xFF, release >> 16 & 0xFF) if release else None
    return parameter_law("px4", version)


def px4(stated: Mapping[str, float], axis: str) -> Controller:
    """The rate controller of PX4.

    Raises DataError: parameters are missing: another version, or a log without them.
    """
    law = px4_law(stated)
    own = law.part("axes")[axis]
    names = {role: law.name_of(role, axis=own) for role in law.names}
    k, p, i, d, cut = _find_stated(stated, *(names[role] for role in ("k", "p", "i", "d", "slope_hz")))
    output = stated.get(names["yaw_output_hz"], 0.0) if axis == "yaw" else 0.0
    return Controller(
        {names["k"]: k, "P": p, "I": i, "D": d},
        UNIT * k * p,
        UNIT * k * i,
        UNIT * k * d,
        0.0,
        ((int(law.part("derivative")["order"]), cut),),
        forward=UNIT * stated.get(names["forward"], 0.0),
        output_filters=((1, output),) if output > 0.0 else (),
        step_s=_step_of(stated, names),
        law=law.title if RELEASE in stated else "",
    )


def ardupilot(stated: Mapping[str, float], axis: str) -> Controller:
    """The rate controller of ArduCopter 4.0 and later.

    Raises DataError: parameters are missing; older versions have one filter.
    """
    law = parameter_law("arducopter")
    own = law.part("axes")[axis]
    names = {role: law.name_of(role, axis=own, number="{number}") for role in law.names}
    if names["older_hz"] in stated and names["target_hz"] not in stated:
        raise DataError(
            f"these are gains of ArduCopter before 4.0, with a single filter ({names['older_hz']}): "
            "not known here",
            hint="fly ArduCopter 4.0 or later; the response to the command: flysid tf LOG -r ardupilot-rate",
        )
    p, i, d, target, error, slope = _find_stated(
        stated, *(names[role] for role in ("p", "i", "d", "target_hz", "error_hz", "slope_hz"))
    )
    step_s = _step_of(stated, names)
    return Controller(
        {names["p"]: p, "I": i, "D": d},
        UNIT * p,
        UNIT * i,
        UNIT * d,
        1.0,
        ((1, slope),),
        ((1, error),),
        ((1, target),),
        UNIT * stated.get(names["forward"], 0.0),
        slope_filtered=True,
        forward_slope=UNIT * stated.get(names["forward_slope"], 0.0),
        error_notches=_notches(stated, law, names["error_notch"]),
        reference_notches=_notches(stated, law, names["target_notch"]),
        step_s=step_s,
        slope_step_s=step_s,
        setpoint_steps=int(law.part("loop")["setpoint_steps"]),
    )


def _step_of(stated: Mapping[str, float], names: Mapping[str, str]) -> float:
    """s, of the loop; 0 where its rate is not stated."""
    loop_hz = stated.get(names["loop_hz"], 0.0)
    return 1.0 / loop_hz if loop_hz > 0.0 else 0.0


def _notches(stated: Mapping[str, float], law: Law, name: str) -> Notches:
    """The notch that a parameter names by its number; none for 0.

    Raises DataError: that filter's own parameters are missing.
    """
    number = int(stated.get(name, 0.0))
    if not number:
        return ()
    roles = ("notch_hz", "notch_q", "notch_db")
    centre, quality, depth = _find_stated(stated, *(law.name_of(role, number=str(number)) for role in roles))
    return ((centre, quality, float(10.0 ** (-depth / 20.0))),)


def _find_stated(stated: Mapping[str, float], *names: str) -> tuple[float, ...]:
    missing = [name for name in names if name not in stated]
    if missing:
        raise DataError(
            f"the log does not state {', '.join(missing)}",
            hint="log the parameters; known are PX4 1.12 on and ArduCopter 4.0 on",
        )
    return tuple(stated[name] for name in names)
