"""The motors of a multicopter in a log: what each is commanded, how fast it turns, where it stands.

Shares are of full thrust where the log allows: PX4's allocator commands thrust, and ArduPilot's outputs are
turned back into it by MOT_THST_EXPO; Betaflight and INAV log shares of full throttle.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import numpy as np

from flysid.dataset import FloatArray
from flysid.facts.modes import family_of
from flysid.ingest.lake.clocked import ClockedLog, Column

Place = tuple[float, float]
FIRST_FUNCTION = {33: 1, 82: 9}
"""ArduPilot: SERVOn_FUNCTION of motors 1 and 9, those between follow."""
FUNCTIONS = 8
CHANNELS = 16
PX4_MOTOR = 101
"""PX4: function of motor 1."""
MOST = 12


@dataclass(frozen=True, eq=False)
class Motor:
    """One motor.

    `number`: as its firmware counts, from 1.
    `command`: share of the range, 0 to 1, over time.
    `place`: forward and right, -1 to 1.
    `spin`: 1 counter-clockwise seen from above, so that it turns the nose to the right; -1 clockwise.
    `speed`: in rpm; None where it is not logged.
    """

    number: int
    command: Column
    place: Place
    spin: float
    speed: Column | None = None


def read_motors(flight: ClockedLog) -> tuple[Motor, ...]:
    """The motors of a multicopter's log; () where it holds no commands, or where the frame is not known.

    >>> import flysid
    >>> from flysid.ingest.align.signals import FlightLog
    >>> read_motors(ClockedLog(FlightLog(flysid.read("sample_logs/01-multisine-seed1.tlog"))))
    ()
    """
    reader = READERS.get(flight.family)
    return tuple(reader(flight)) if reader and is_multicopter(flight) else ()


def _around(degrees_and_spins: Sequence[Sequence[float]]) -> list[tuple[Place, float]]:
    turned = [(np.radians(degrees), spin) for degrees, spin in degrees_and_spins]
    return [((float(np.cos(angle)), float(np.sin(angle))), spin) for angle, spin in turned]


def is_multicopter(flight: ClockedLog) -> bool:
    """Whether it hovers on its motors, as far as the log says: a rover has a FRAME_CLASS, too."""
    if flight.family == "ardupilot":
        return family_of(flight.info.get("vehicle", "")) == "copter"
    return flight.family != "px4" or flight.parameters.get("CA_AIRFRAME", 0.0) == 0.0


def _ardupilot(flight: ClockedLog) -> Iterator[Motor]:
    parameters = flight.parameters
    kind = parameters.get("FRAME_TYPE", parameters.get("FRAME", 1.0))
    frame = f"{parameters.get('FRAME_CLASS', 1.0):.0f}/{kind:.0f}"
    layout = _around(_frames()["ardupilot"].get(frame, ()))
    channels = _channels(flight, len(layout))
    for number, (place, spin) in enumerate(layout, 1):
        channel = channels.get(number, 0)
        output = flight.quantity(
            f"RCOU.C{channel}", f"SERVO_OUTPUT_RAW.servo{channel}_raw", unit="us", stated="us"
        )
        if output is None:
            return
        speed = flight.quantity(f"ESC[{channel - 1}].RPM", f"ESC{channel}.RPM", unit="rpm", stated="rpm")
        yield Motor(
            number,
            replace(output, unit="", values=_thrust(output.values, flight)),
            place,
            spin,
            _turning(speed),
        )


def _channels(flight: ClockedLog, motors: int) -> dict[int, int]:
    """Motor -> output channel, by the functions of the outputs; in their order where none is logged."""
    found = {}
    for channel in range(1, CHANNELS + 1):
        function = flight.parameters.get(f"SERVO{channel}_FUNCTION", 0)
        for first, motor in FIRST_FUNCTION.items():
            if first <= function < first + FUNCTIONS:
                found[int(function) - first + motor] = channel
    return found or {motor: motor for motor in range(1, motors + 1)}


def _thrust(output_us: FloatArray, flight: ClockedLog) -> FloatArray:
    """Share of full thrust that an output stands for (the law of AP_MotorsMulticopter, backwards)."""
    value = flight.parameters.get
    low = value("MOT_PWM_MIN", 0.0) or value("RC3_MIN", 1000.0)
    high = value("MOT_PWM_MAX", 0.0) or value("RC3_MAX", 2000.0)
    idle, top = value("MOT_SPIN_MIN", 0.15), value("MOT_SPIN_MAX", 0.95)
    expo = value("MOT_THST_EXPO", 0.65)
    throttle = np.clip(((output_us - low) / (high - low) - idle) / (top - idle), 0.0, 1.0)
    return (1.0 - expo) * throttle + expo * throttle**2


def _px4(flight: ClockedLog) -> Iterator[Motor]:
    count = int(flight.parameters.get("CA_ROTOR_COUNT", 0))
    speeds = dict(_px4_speeds(flight))
    if not count:
        yield from _px4_mixed(flight)
        return
    arms = [_px4_place(flight, i) for i in range(min(count, MOST))]
    longest = max((np.hypot(*place) for place, _ in arms), default=0.0)
    for i, (place, spin) in enumerate(arms):
        command = flight.quantity(f"actuator_motors.control[{i}]")
        if command is None or longest == 0.0:
            return
        scaled = (float(place[0] / longest), float(place[1] / longest))
        yield Motor(i + 1, command, scaled, spin, speeds.get(i + 1))


def _px4_place(flight: ClockedLog, rotor: int) -> tuple[Place, float]:
    value = flight.parameters.get
    place = value(f"CA_ROTOR{rotor}_PX", 0.0), value(f"CA_ROTOR{rotor}_PY", 0.0)
    return place, float(np.sign(value(f"CA_ROTOR{rotor}_KM", 0.05)))


def _px4_mixed(flight: ClockedLog) -> Iterator[Motor]:
    """Before release 1.13: outputs of a mixer; a quadrotor is taken for one in X."""
    if flight.parameters.get("MAV_TYPE") != QUADROTOR:
        return
    low, high = (flight.parameters.get(f"PWM_{end}", 0.0) for end in ("MIN", "MAX"))
    if not low < high:
        return
    for i, (place, spin) in enumerate(_around(_frames()["quad_x"]["px4"])):
        output = flight.quantity(f"actuator_outputs.output[{i}]")
        if output is None or output.values.max() <= low:
            return
        share = np.clip((output.values - low) / (high - low), 0.0, 1.0)
        yield Motor(i + 1, replace(output, values=share), place, spin)


QUADROTOR = 2
"""MAV_TYPE."""


def _px4_speeds(flight: ClockedLog) -> Iterator[tuple[int, Column]]:
    """Motor -> speed: the ESCs are numbered by output, and say which motor is theirs."""
    for i in range(8):
        speed = flight.quantity(f"esc_status.esc[{i}].esc_rpm", unit="rpm", stated="rpm")
        function = flight.quantity(f"esc_status.esc[{i}].actuator_function")
        known = _turning(speed)
        if known is not None and function is not None:
            yield int(np.median(function.values)) - PX4_MOTOR + 1, known


def _betaflight(flight: ClockedLog) -> Iterator[Motor]:
    columns = [flight.quantity(f"main.motor[{i}]") for i in range(4)]
    logged = [column for column in columns if column is not None]
    if len(logged) < len(columns) or flight.quantity("main.motor[4]") is not None:
        return
    low, high = _betaflight_range(flight, max(float(c.values.max()) for c in logged))
    reversed_spin = flight.headers.get("yaw_motors_reversed", "0") not in ("", "0")
    for i, (place, spin) in enumerate(_around(_frames()["quad_x"]["betaflight"])):
        share = np.clip((logged[i].values - low) / (high - low), 0.0, 1.0)
        speed = flight.quantity(f"main.eRPM[{i}]", unit="rpm")
        command = replace(logged[i], values=share)
        yield Motor(i + 1, command, place, -spin if reversed_spin else spin, _turning(speed))


def _betaflight_range(flight: ClockedLog, highest: float) -> tuple[float, float]:
    """From idle to full in the log's units: pulses in us, or DShot's 48 to 2047, logged as up to 2048."""
    stated = flight.headers.get("motorOutput", "").split(",")
    if len(stated) == 2 and all(part.strip().isdigit() for part in stated):
        return float(stated[0]), max(float(stated[1]), highest)
    if flight.parameters.get("motor_pwm_protocol", 0.0) >= FIRST_DSHOT:
        return DSHOT[0], max(DSHOT[1], highest)
    return flight.parameters.get("minthrottle", 1000.0), flight.parameters.get("maxthrottle", 2000.0)


FIRST_DSHOT = 5
DSHOT = (48.0, 2047.0)


def _turning(speed: Column | None) -> Column | None:
    """A speed that was ever above zero; ESCs without telemetry log zeros."""
    return speed if speed is not None and bool((speed.values > 0.0).any()) else None


READERS: dict[str, Callable[[ClockedLog], Iterator[Motor]]] = {
    "ardupilot": _ardupilot,
    "px4": _px4,
    "betaflight": _betaflight,
    "inav": _betaflight,
    "emuflight": _betaflight,
}


@cache
def _frames() -> dict[str, dict[str, list[list[float]]]]:
    return tomllib.loads(files(__package__).joinpath("frames.toml").read_text("utf-8"))
