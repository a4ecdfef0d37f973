"""Proposed parameters as a file that the ground station of their firmware loads, old values beside them."""

from __future__ import annotations

from collections.abc import Container, Sequence

from flysid.reviews.fact import Action, Change
from flysid.showing import significant

WHOLE_NUMBER = 6
REAL_NUMBER = 9
"""Types of a parameter in QGroundControl's files: MAV_PARAM_TYPE_INT32 and REAL32."""


def parameter_text(actions: Sequence[Action], family: str, whole: Container[str] = ()) -> str:
    """The changes of all actions; "" where they have none.

    `family`: firmware: "ardupilot" (Mission Planner's NAME,VALUE), "px4" (QGroundControl's columns), or one
        whose command line takes `set name = value`: Betaflight, INAV.
    `whole`: names of parameters that are whole numbers, which QGroundControl's columns state.

    >>> hover = Action("Set the hover throttle", "", (Change("MPC_THR_HOVER", 0.5, 0.66),))
    >>> print(parameter_text([hover], "px4").splitlines()[-1].split())
    ['1', '1', 'MPC_THR_HOVER', '0.66', '9']
    """
    changes = [change for action in actions for change in action.changes]
    if not changes:
        return ""
    head = ["# proposed by flysid review; the values that were flown stand in the comments"]
    lines = [line for change in changes for line in _lines(change, family, whole)]
    if family in ("betaflight", "inav", "emuflight"):
        lines.append("save")
    return "\n".join([*head, *lines, ""])


def _lines(change: Change, family: str, whole: Container[str]) -> list[str]:
    was = f"# {change.name} was {significant(change.old, 6)}"
    new = significant(change.new, 6)
    if family == "px4":
        kind = WHOLE_NUMBER if change.name in whole else REAL_NUMBER
        return [was, f"1\t1\t{change.name}\t{new}\t{kind}"]
    if family == "ardupilot":
        return [was, f"{change.name},{new}"]
    return [was, f"set {change.name} = {new}"]


def file_suffix(family: str) -> str:
    """ ".params" for ArduPilot and PX4, ".txt" for command lines."""
    return ".params" if family in ("ardupilot", "px4") else ".txt"
