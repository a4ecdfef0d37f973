"""A plan as parameters of autopilots that can fly it by themselves: both know sweeps, neither multisines.

ArduPilot Copter (4.0 on, where SYSTEMID is built in): SID_* of ArduCopter/mode_systemid.cpp. A run sweeps the
one axis of SID_AXIS: two cycles at the lowest frequency, then a logarithmic sweep that ends at SID_T_REC.
PX4 planes (v1.16 on): FW_AT_* of fw_autotune_attitude_control, a sweep that the autotune sends by axis; its
amplitude has no unit. PX4's multicopters can only send the autotune's own steps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from flysid.errors import UsageError
from flysid.plan.flightplan import CommandedAxis, FlightPlan

SID_AXES: Mapping[str, tuple[str, Mapping[str, int]]] = {
    "angle": ("deg", {"roll": 1, "pitch": 2}),
    "recover": ("deg", {"roll": 4, "pitch": 5}),
    "rate": ("deg/s", {"roll": 7, "pitch": 8, "yaw": 9}),
    "mixer": ("", {"roll": 10, "pitch": 11, "yaw": 12, "throttle": 13}),
}
"""Where the sweep enters: the unit of SID_MAGNITUDE, and SID_AXIS of every axis."""
SID_HZ = (0.01, 100.0)
SID_LONGEST_S = 255
FW_HZ = (0.1, 30.0)
FW_SECONDS = (5, 120)
FW_AXES = {"roll": 1, "pitch": 2, "yaw": 4}


@dataclass(frozen=True)
class ParameterFile:
    """A file of parameters, and what to do with it."""

    name: str
    text: str
    words: str


def ardupilot(plan: FlightPlan, place: str) -> list[ParameterFile]:
    """One file of SID_* an axis, each the same sweep.

    `place`: "angle", "recover", "rate" or "mixer": where the sweep enters.
    Raises UsageError: not a chirp; an axis, unit, frequency or duration that ArduPilot does not have.
    """
    require_chirp(plan.kind, "ArduPilot")
    unit, axes = SID_AXES[place]
    low, high = plan.band_hz
    seconds = plan.seconds / len(plan.axes)
    if not (SID_HZ[0] <= low and high <= SID_HZ[1]) or seconds > SID_LONGEST_S:
        raise UsageError(
            f"ArduPilot sweeps {SID_HZ[0]:g} to {SID_HZ[1]:g} Hz in at most {SID_LONGEST_S} s an axis",
            hint="another --band or fewer --seconds",
        )
    return [
        _sid_file(axis, _sid_number(axis, place, unit, axes), plan.band_hz, seconds) for axis in plan.axes
    ]


def _sid_number(axis: CommandedAxis, place: str, unit: str, axes: Mapping[str, int]) -> int:
    if axis.name not in axes:
        raise UsageError(
            f"ArduPilot has no axis {axis.name!r} at {place}", hint=f"name axes {', '.join(axes)}"
        )
    if axis.unit not in ("", unit):
        raise UsageError(
            f"{axis.name} is in {axis.unit!r}; at {place} ArduPilot counts in {unit or 'shares from 0 to 1'}",
            hint="state the amplitude in that unit",
        )
    if place == "mixer" and axis.peak > 1.0:
        raise UsageError(
            f"{axis}: the whole of a mixer axis is 1",
            hint=f"e.g. {axis.name}=0.1, and more once that was calm",
        )
    return axes[axis.name]


def _sid_file(
    axis: CommandedAxis, number: int, band_hz: tuple[float, float], seconds: float, *, fade_out_s: float = 2.0
) -> ParameterFile:
    low, high = band_hz
    values = {
        "SID_AXIS": number,
        "SID_MAGNITUDE": axis.peak,
        "SID_F_START_HZ": low,
        "SID_F_STOP_HZ": high,
        "SID_T_FADE_IN": min(20.0, 1.0 / low),
        "SID_T_REC": seconds,
        "SID_T_FADE_OUT": fade_out_s,
    }
    text = "".join(f"{name},{value:.6g}\n" for name, value in values.items())
    return ParameterFile(
        f"ardupilot-{axis.name}.param",
        text,
        f"load it, fly level and high, switch to SYSTEMID and wait {seconds:.0f} s; set LOG_BITMASK to log "
        "fast attitude. Afterwards: flysid tf LOG -r ardupilot-sysid",
    )


def px4_plane(plan: FlightPlan) -> ParameterFile:
    """FW_AT_* of PX4 v1.16 and later, as QGroundControl loads them; gains are left as they are.

    Raises UsageError: not a chirp; an axis, frequency or duration that PX4 does not have.
    """
    require_chirp(plan.kind, "PX4")
    strange = [a.name for a in plan.axes if a.name not in FW_AXES]
    if strange:
        raise UsageError(
            f"PX4's planes have no axis {', '.join(strange)}", hint=f"name axes {', '.join(FW_AXES)}"
        )
    low, high = plan.band_hz
    seconds = plan.seconds / len(plan.axes)
    if not (FW_HZ[0] <= low and high <= FW_HZ[1] and FW_SECONDS[0] <= seconds <= FW_SECONDS[1]):
        raise UsageError(
            f"PX4 sweeps {FW_HZ[0]:g} to {FW_HZ[1]:g} Hz in {FW_SECONDS[0]} to {FW_SECONDS[1]} s an axis",
            hint="another --band or other --seconds",
        )
    real, whole = 9, 6  # MAV_PARAM_TYPE
    rows = [
        ("FW_AT_APPLY", 0, whole),
        ("FW_AT_AXES", sum(FW_AXES[a.name] for a in plan.axes), whole),
        ("FW_AT_SYSID_TYPE", 2, whole),
        ("FW_AT_SYSID_F0", low, real),
        ("FW_AT_SYSID_F1", high, real),
        ("FW_AT_SYSID_TIME", seconds, real),
    ]
    text = "".join(f"1\t1\t{name}\t{value:.6g}\t{kind}\n" for name, value, kind in rows)
    return ParameterFile(
        "px4-plane.params",
        text,
        "load it in QGroundControl (PX4 v1.16 or later, planes), then run the autotune; FW_AT_APPLY 0 leaves "
        "the gains. PX4's amplitude FW_AT_SYSID_AMP has no unit: the file leaves it as it is. "
        "Afterwards: flysid tf LOG -r px4-rates",
    )


def require_chirp(kind: str, firmware: str) -> None:
    """Raise UsageError for a kind of flight that an autopilot does not make by itself."""
    if kind != "chirp":
        raise UsageError(
            f"{firmware} cannot fly {kind} by itself",
            hint="--kind chirp; plan.csv is for a computer beside the autopilot",
        )
