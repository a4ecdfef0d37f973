"""`python -m bench.review_faults [--seed N] [--trials 40] [--firmware NAME]`: is the first sentence right?

Quadrotors with one fault each and as many sound ones are flown in simulation and logged as ArduCopter, PX4,
Betaflight or INAV would; planes and rovers are drawn, and logged as ArduPlane and Rover would. All are
reviewed. Of a faulty flight the first sentence must name the fault (goal 90 %); it is false where it
complains of something else (at most 2 %). A sound flight gets no action (95 %) and no complaint. Seeds are
new in each run, and printed.
"""

from __future__ import annotations

import argparse
import random
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import flysid
from bench.faulty_blackbox import MOTORS as BLACKBOX_ORDER
from bench.faulty_blackbox import blackbox_bytes
from bench.faulty_carriers import PLANE, ROVER, carrier_bytes, travel
from bench.faulty_dataflash import dataflash_bytes
from bench.faulty_quadrotor import GROUND_S, RATE_HZ, Flight, Quadrotor, critical_gain, draw_quadrotor
from bench.faulty_sensors import fly
from bench.faulty_ulog import ulog_bytes
from flysid.ingest.align.signals import FlightLog
from flysid.reviews.fact import Grade
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.review import review_flight
from flysid.reviews.reviewed import NOTHING_FOUND, Review

BATCH = 16
GOALS = {"right": 0.90, "false": 0.02, "quiet": 0.95}
Rng = np.random.Generator


Names = Callable[[str, Flight], bool]


@dataclass(frozen=True)
class Fault:
    """A kind of fault.

    Attributes
    ----------
    spoil : a sound vehicle with this fault, of a strength that is drawn.
    names : whether a first sentence names it, of the flight that was flown.
    """

    spoil: Callable[[Quadrotor, Rng], Quadrotor]
    names: Names


def _holds(pattern: str) -> Names:
    """Whether a sentence holds an expression."""
    return lambda text, _: bool(re.search(pattern, text))


def _names_motor(text: str, flight: Flight) -> bool:
    return _names(text, flight.vehicle.weak)


def _names(text: str, motor: int) -> bool:
    """Whether a sentence names a motor, as its firmware counts."""
    numbers = (motor + 1, 1 + BLACKBOX_ORDER.index(motor))
    return any(re.search(rf"[Mm]otor {number}\b", text) for number in numbers)


def _names_first(text: str, _: Flight) -> bool:
    """The simulator's first motor is number 1, in a blackbox number 2; a plane has one."""
    return bool(re.search(r"([Mm]otor|[Pp]ropeller) [12]\b|The motor stops", text))


def _names_tone(text: str, flight: Flight, *, within: float = 0.06) -> bool:
    """Whether a sentence is about vibration, or states a frequency at which the bent motor turned."""
    if "rpm" not in flight.columns:
        return bool(re.search("ibrat|[Ss]hake", text))
    flying = (flight.time_s > 2.0 * GROUND_S) & (flight.time_s < flight.time_s[-1] - 2.0 * GROUND_S)
    turned_hz = flight["rpm"][flying, flight.vehicle.bent].mean() / 60.0
    stated = [float(number) for number in re.findall(r"(\d+(?:\.\d+)?) Hz", text)]
    return (
        "ibrat" in text
        or _names(text, flight.vehicle.bent)
        or any(abs(hz / turned_hz - 1.0) < within for hz in stated)
    )


def _weak_motor(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    weakness = rng.uniform(0.15, 0.25)
    return replace(vehicle, weak=int(rng.integers(4)), weakness=weakness, propeller=bool(rng.integers(2)))


def _bent_shaft(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, bent=int(rng.integers(4)), bent_m_s2=rng.uniform(60.0, 110.0))


def _heavy(vehicle: Quadrotor, _: Rng) -> Quadrotor:
    return replace(vehicle, heavier=1.2)


def _sagging(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    """A battery that loses 0.4 to 0.7 V a cell in hover."""
    hover_a = vehicle.mass_kg * 9.81 * 17.0 * np.sqrt(vehicle.hover) / (3.9 * vehicle.cells)
    return replace(vehicle, resistance_ohm=rng.uniform(0.4, 0.7) * vehicle.cells / hover_a)


def _glitching(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, glitch_s=rng.uniform(20.0, 45.0), glitch_m=rng.uniform(15.0, 60.0))


def _loose(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, loose_m_s2=rng.uniform(45.0, 80.0))


def _late_yaw(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, yaw_rad_s=rng.uniform(1.2, 1.8))


def _hot(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, gain=rng.uniform(1.15, 1.5) * critical_gain(vehicle))


def _draw_moment(rng: Rng) -> float:
    return float(rng.uniform(20.0, 42.0))


def _dead_motor(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, fails_s=_draw_moment(rng))


def _lost_propeller(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, fails_s=_draw_moment(rng), propeller=True)


def _slipping(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, slips_s=_draw_moment(rng), slip_s=rng.uniform(0.15, 0.22))


def _brown(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, browns_s=_draw_moment(rng))


def _jammed(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, jam_s=_draw_moment(rng))


def _disturbed(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    """A compass beside the battery's wires: 0.7 to 1.5 of the earth's field over the range of the current."""
    hover_a = vehicle.mass_kg * 9.81 * 17.0 * np.sqrt(vehicle.hover) / (3.9 * vehicle.cells)
    return replace(vehicle, wires=rng.uniform(0.7, 1.5) / hover_a)


def _lost_estimate(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    at_s = _draw_moment(rng)
    drift = rng.uniform(1.0, 3.0)
    return replace(vehicle, drift_s=at_s - 4.0, drift_m_s=drift, incident="EKF", incident_s=at_s)


def _incident(name: str) -> Callable[[Quadrotor, Rng], Quadrotor]:
    return lambda vehicle, rng: replace(vehicle, incident=name, incident_s=_draw_moment(rng))


def _hitting(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, incident="crash", incident_s=_draw_moment(rng))


def _empty(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    hover_a = vehicle.mass_kg * 9.81 * 17.0 * np.sqrt(vehicle.hover) / (3.9 * vehicle.cells)
    at_s = _draw_moment(rng)
    used_ah = hover_a * at_s / 3600.0
    return replace(vehicle, capacity_ah=used_ah / 0.8, incident="battery", incident_s=at_s)


def _dropped(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, hard_m_s=rng.uniform(2.2, 4.5))


FAULTS = {
    "motor failure": Fault(_dead_motor, _names_first),
    "propeller loss": Fault(_lost_propeller, _names_first),
    "desync": Fault(_slipping, _holds(r"[Mm]otor [23]\b")),
    "brown-out": Fault(_brown, _holds(r"brown-out|supply|battery")),
    "GPS interference": Fault(_jammed, _holds(r"GPS|satellites|[Jj]am")),
    "compass interference": Fault(_disturbed, _holds(r"[Cc]ompass|magnetic")),
    "EKF failure": Fault(_lost_estimate, _holds(r"EKF|[Ee]stimat")),
    "battery failsafe": Fault(_empty, _holds(r"[Bb]attery|\b[Cc]ell")),
    "radio failsafe": Fault(_incident("radio"), _holds(r"[Rr]adio")),
    "fence breach": Fault(_incident("fence"), _holds(r"[Ff]ence")),
    "crash": Fault(_hitting, _holds(r"[Cc]rash")),
    "hard landing": Fault(_dropped, _holds(r"[Ll]anded hard")),
    "weak motor": Fault(_weak_motor, _names_motor),
    "bent shaft": Fault(_bent_shaft, _names_tone),
    "mass +20 %": Fault(_heavy, _holds(r"[Hh]over")),
    "sagging battery": Fault(_sagging, _holds(r"[Bb]attery|\b[Cc]ell")),
    "GPS glitch": Fault(_glitching, _holds("GPS")),
    "loose accelerometer": Fault(_loose, _holds(r"[Aa]ccelerometer|[Vv]ibrat|[Cc]lip")),
    "late yaw": Fault(_late_yaw, _holds(r"[Yy]aw")),
    "gains too high": Fault(_hot, _holds(r"[Oo]scillat|gains? .*too high")),
}
SOUND = "sound"
FIRMWARES = ("copter", "px4", "betaflight", "inav", "plane", "rover")
COPTERS = ("copter", "px4")
CARRIERS = {"plane": PLANE, "rover": ROVER}
STATING = ("copter", "px4", "plane", "rover")
SHOWN: Mapping[str, Sequence[str]] = {
    "motor failure": FIRMWARES,
    "propeller loss": ("copter", "px4", "betaflight", "inav"),
    "desync": ("copter", "px4", "betaflight"),
    "GPS interference": ("copter", "px4", "inav", "plane", "rover"),
    "compass interference": STATING,
    "EKF failure": STATING,
    "battery failsafe": STATING,
    "fence breach": STATING,
    "crash": ("plane", "rover"),
    "hard landing": ("copter", "px4", "inav"),
    "weak motor": ("copter", "px4", "betaflight", "inav"),
    "bent shaft": ("copter", "px4", "betaflight", "plane", "rover"),
    "mass +20 %": COPTERS,
    "sagging battery": ("copter", "px4", "betaflight", "inav"),
    "GPS glitch": ("copter", "px4", "inav", "plane", "rover"),
    "loose accelerometer": COPTERS,
    "late yaw": ("copter", "px4", "betaflight", "inav"),
    "gains too high": ("copter", "px4", "betaflight", "inav"),
}
"""Fault -> firmwares whose logs hold what shows it, and whose vehicles can have it; others: all."""
IMU_HZ = (25.0, 50.0, 100.0, 200.0)
"""Rates at which planes and rovers log their sensors."""


@dataclass(frozen=True)
class Trial:
    """One flight: what is wrong with it, who logs it, and whether its ESCs tell how fast they turn."""

    kind: str
    vehicle: Quadrotor
    firmware: str
    rpm: bool
    imu_hz: float = RATE_HZ


def draw(seed: int, trials: int, firmwares: Sequence[str] = COPTERS) -> list[Trial]:
    """Trials of all kinds by turns, each of a firmware that shows it, and as many of sound vehicles."""
    rng = np.random.default_rng(seed)
    shown = [kind for kind in FAULTS if set(SHOWN.get(kind, FIRMWARES)) & set(firmwares)]
    kinds = [shown[i % len(shown)] for i in range(trials)] + [SOUND] * trials
    found = []
    for kind in kinds:
        vehicle = draw_quadrotor(rng)
        spoilt = vehicle if kind == SOUND else FAULTS[kind].spoil(vehicle, rng)
        able = [name for name in firmwares if name in SHOWN.get(kind, FIRMWARES)]
        firmware = str(rng.choice(able))
        rate_hz = float(rng.choice(IMU_HZ)) if firmware in CARRIERS else RATE_HZ
        found.append(Trial(kind, spoilt, firmware, bool(rng.integers(2)), rate_hz))
    return found


def fly_all(trials: Sequence[Trial]) -> list[Flight]:
    """The flights of trials in their order; quadrotors fly together."""
    quadrotors = iter(fly([t.vehicle for t in trials if t.firmware not in CARRIERS]))
    return [
        travel(t.vehicle, CARRIERS[t.firmware]) if t.firmware in CARRIERS else next(quadrotors)
        for t in trials
    ]


SUFFIXES = {"px4": ".ulg", "betaflight": ".bbl", "inav": ".TXT"}


def log_bytes(trial: Trial, flight: Flight) -> bytes:
    """The log of a trial, as its firmware writes it."""
    if trial.firmware in CARRIERS:
        return carrier_bytes(flight, CARRIERS[trial.firmware], imu_hz=trial.imu_hz)
    if trial.firmware in ("betaflight", "inav"):
        return blackbox_bytes(flight, trial.firmware, rpm=trial.rpm)
    return ulog_bytes(flight) if trial.firmware == "px4" else dataflash_bytes(flight, rpm=trial.rpm)


def write(trial: Trial, flight: Flight, folder: Path, name: str) -> Path:
    """The file of a trial's log."""
    path = folder / f"{name}_{trial.firmware}{SUFFIXES.get(trial.firmware, '.bin')}"
    path.write_bytes(log_bytes(trial, flight))
    return path


def judge(trial: Trial, flight: Flight, found: Review) -> str:
    """ "right", "false" or "silent"; of a sound flight "false" where something is complained of."""
    first = found.findings[0]
    complains = first is not NOTHING_FOUND and first.grade.rank >= Grade.WATCH.rank
    if trial.kind != SOUND and complains and FAULTS[trial.kind].names(first.text, flight):
        return "right"
    if complains:
        return "false"
    return "right" if trial.kind == SOUND else "silent"


def compare(trials: Sequence[Trial], folder: Path, *, tells: bool = True) -> dict[str, Counter[str]]:
    """Kind -> how often its first sentence was right, false or silent, and actions of sound flights.

    Parameters
    ----------
    folder : for the logs.
    tells : print a line for every flight that is not judged rightly.
    """
    score: dict[str, Counter[str]] = {}
    for begin in range(0, len(trials), BATCH):
        batch = trials[begin : begin + BATCH]
        flights = fly_all(batch)
        for i, (trial, flight) in enumerate(zip(batch, flights, strict=True), begin):
            path = write(trial, flight, folder, f"{i:03d}_{trial.kind.replace(' ', '_')}")
            began_s = time.process_time()
            found = review_flight(LoggedFlight(FlightLog(flysid.read(path))))
            spent_s = time.process_time() - began_s
            verdict = judge(trial, flight, found)
            count = score.setdefault(trial.kind, Counter())
            count[verdict] += 1
            count["action"] += bool(found.actions)
            if tells and (verdict != "right" or (trial.kind == SOUND and found.actions)):
                sentences = "; ".join(f"{f.text} ({f.grade.value})" for f in found.findings)
                done = "; ".join(a.title for a in found.actions)
                print(f"{path.name}: {verdict}: {sentences} | {done} | {spent_s:.2f} s", flush=True)
            for words in found.broken:
                print(f"{path.name}: {words}")
    return score


def shares(score: dict[str, Counter[str]]) -> dict[str, float]:
    """Of faulty flights those that are named, of all those wronged, of sound ones those left alone."""
    faulty = sum((count for kind, count in score.items() if kind != SOUND), Counter[str]())
    sound = score.get(SOUND, Counter())
    n = max(1, sum(faulty[v] for v in ("right", "false", "silent")))
    m = max(1, sum(sound[v] for v in ("right", "false", "silent")))
    return {
        "right": faulty["right"] / n,
        "false": (faulty["false"] + sound["false"]) / (n + m),
        "quiet": 1.0 - sound["action"] / m,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--trials", type=int, default=40, help="faulty flights, and as many sound ones")
    parser.add_argument("--firmware", action="append", choices=FIRMWARES, help="only of these; all otherwise")
    parser.add_argument("--keep", type=Path, default=None, help="folder in which the logs stay")
    chosen = parser.parse_args()
    seed = random.SystemRandom().randrange(1 << 40) if chosen.seed is None else chosen.seed
    print(f"seed {seed}")
    with TemporaryDirectory() as scratch:
        folder = chosen.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        score = compare(draw(seed, chosen.trials, chosen.firmware or FIRMWARES), folder)
    for kind, count in score.items():
        print(f"{kind:20} {dict(count)}")
    for name, share in shares(score).items():
        print(f"{name:6} {100 * share:.1f} % (goal {100 * GOALS[name]:.0f} %)")


if __name__ == "__main__":
    main()
