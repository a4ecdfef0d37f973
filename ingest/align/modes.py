"""Names of flight modes, which logs carry as numbers only.

ArduPilot's numbers hang on the kind of vehicle (ArduCopter/mode.h, ArduPlane/mode.h); PX4's are those of
`vehicle_status.nav_state` (msg/VehicleStatus.msg). What is not listed stays a number.
"""

from __future__ import annotations

from collections.abc import Mapping

from flysid.flight import message_of

COPTER: Mapping[int, str] = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE",
    9: "LAND", 11: "DRIFT", 13: "SPORT", 14: "FLIP", 15: "AUTOTUNE", 16: "POSHOLD", 17: "BRAKE", 18: "THROW",
    19: "AVOID_ADSB", 20: "GUIDED_NOGPS", 21: "SMART_RTL", 22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG",
    25: "SYSTEMID", 26: "AUTOROTATE", 27: "AUTO_RTL", 28: "TURTLE",
}  # fmt: skip
PLANE: Mapping[int, str] = {
    0: "MANUAL", 1: "CIRCLE", 2: "STABILIZE", 3: "TRAINING", 4: "ACRO", 5: "FBWA", 6: "FBWB", 7: "CRUISE",
    8: "AUTOTUNE", 10: "AUTO", 11: "RTL", 12: "LOITER", 13: "TAKEOFF", 14: "AVOID_ADSB", 15: "GUIDED",
    17: "QSTABILIZE", 18: "QHOVER", 19: "QLOITER", 20: "QLAND", 21: "QRTL", 22: "QAUTOTUNE", 23: "QACRO",
    24: "THERMAL",
}  # fmt: skip
PX4: Mapping[int, str] = {
    0: "MANUAL", 1: "ALTCTL", 2: "POSCTL", 3: "AUTO_MISSION", 4: "AUTO_LOITER", 5: "AUTO_RTL", 10: "ACRO",
    12: "DESCEND", 13: "TERMINATION", 14: "OFFBOARD", 15: "STAB", 17: "AUTO_TAKEOFF", 18: "AUTO_LAND",
    19: "AUTO_FOLLOW_TARGET", 20: "AUTO_PRECLAND", 21: "ORBIT", 22: "AUTO_VTOL_TAKEOFF",
}  # fmt: skip
COPTERS = ("copter", "quadrotor", "hexarotor", "octorotor", "tricopter", "coaxial", "helicopter")
PLANES = ("plane", "fixed_wing")
ARDUPILOT = (("MODE", "ModeNum"), ("MODE", "Mode"), ("HEARTBEAT", "custom_mode"))


def mode_names(stream: str, field: str, info: Mapping[str, str]) -> Mapping[int, str]:
    """Number -> name of the modes in a column of a log; empty where the column holds none, or none is known.

    Parameters
    ----------
    stream : key of the stream, e.g. "1.1/HEARTBEAT".
    info : facts about the vehicle: "autopilot", "vehicle".
    """
    message = message_of(stream).partition("#")[0]
    if (message, field) == ("vehicle_status", "nav_state"):
        return PX4
    if (message, field) not in ARDUPILOT or not info.get("autopilot", "").startswith("ardupilot"):
        return {}
    vehicle = info.get("vehicle", "").lower()
    return COPTER if vehicle in COPTERS else PLANE if vehicle in PLANES else {}
