"""`python -m bench.review_faults [--seed N] [--trials 40] [--keep DIR]`: is the first sentence right?

Quadrotors with one fault each and as many sound ones are flown in simulation, logged as DataFlash and as
ULog by turns, and reviewed. Of a faulty flight the first sentence must name the fault (goal 90 %); it is
false where it complains of something else (at most 2 %). A sound flight gets no action (95 %) and no
complaint. Seeds are new in each run, and printed.
"""

from __future__ import annotations

import argparse
import random
import re
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import flysid
from bench.faulty_dataflash import dataflash_bytes
from bench.faulty_quadrotor import GROUND_S, Flight, Quadrotor, critical_gain, draw_quadrotor
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
    return bool(re.search(rf"[Mm]otor {flight.vehicle.weak + 1}\b", text))


def _names_tone(text: str, flight: Flight, *, within: float = 0.06) -> bool:
    """Whether a sentence is about vibration, or states a frequency at which the bent motor turned."""
    flying = (flight.time_s > 2.0 * GROUND_S) & (flight.time_s < flight.time_s[-1] - 2.0 * GROUND_S)
    turned_hz = flight["rpm"][flying, flight.vehicle.bent].mean() / 60.0
    stated = [float(number) for number in re.findall(r"(\d+(?:\.\d+)?) Hz", text)]
    return "ibrat" in text or any(abs(hz / turned_hz - 1.0) < within for hz in stated)


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


def _empty(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    hover_a = vehicle.mass_kg * 9.81 * 17.0 * np.sqrt(vehicle.hover) / (3.9 * vehicle.cells)
    at_s = _draw_moment(rng)
    used_ah = hover_a * at_s / 3600.0
    return replace(vehicle, capacity_ah=used_ah / 0.8, incident="battery", incident_s=at_s)


def _dropped(vehicle: Quadrotor, rng: Rng) -> Quadrotor:
    return replace(vehicle, hard_m_s=rng.uniform(2.2, 4.5))


FAULTS = {
    "motor failure": Fault(_dead_motor, _holds(r"[Mm]otor 1")),
    "propeller loss": Fault(_lost_propeller, _holds(r"[Mm]otor 1|propeller 1|[Pp]ropeller")),
    "desync": Fault(_slipping, _holds(r"[Mm]otor 2")),
    "brown-out": Fault(_brown, _holds(r"brown-out|supply")),
    "GPS interference": Fault(_jammed, _holds(r"GPS|satellites|[Jj]am")),
    "compass interference": Fault(_disturbed, _holds(r"[Cc]ompass|magnetic")),
    "EKF failure": Fault(_lost_estimate, _holds(r"EKF|[Ee]stimat")),
    "battery failsafe": Fault(_empty, _holds(r"[Bb]attery|\b[Cc]ell")),
    "radio failsafe": Fault(_incident("radio"), _holds(r"[Rr]adio")),
    "fence breach": Fault(_incident("fence"), _holds(r"[Ff]ence")),
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


@dataclass(frozen=True)
class Trial:
    """One flight: what is wrong with it, and how it is logged."""

    kind: str
    vehicle: Quadrotor
    px4: bool
    rpm: bool


def draw(seed: int, trials: int) -> list[Trial]:
    """Trials of all kinds by turns, and as many of sound vehicles."""
    rng = np.random.default_rng(seed)
    kinds = [list(FAULTS)[i % len(FAULTS)] for i in range(trials)] + [SOUND] * trials
    found = []
    for kind in kinds:
        vehicle = draw_quadrotor(rng)
        spoilt = vehicle if kind == SOUND else FAULTS[kind].spoil(vehicle, rng)
        found.append(Trial(kind, spoilt, px4=bool(rng.integers(2)), rpm=bool(rng.integers(2))))
    return found


def write(trial: Trial, flight: Flight, folder: Path, name: str) -> Path:
    """The log of a trial."""
    path = folder / f"{name}{'.ulg' if trial.px4 else '.bin'}"
    path.write_bytes(ulog_bytes(flight) if trial.px4 else dataflash_bytes(flight, rpm=trial.rpm))
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
        flights = fly([t.vehicle for t in batch])
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
    parser.add_argument("--keep", type=Path, default=None, help="folder in which the logs stay")
    chosen = parser.parse_args()
    seed = random.SystemRandom().randrange(1 << 40) if chosen.seed is None else chosen.seed
    print(f"seed {seed}")
    with TemporaryDirectory() as scratch:
        folder = chosen.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        score = compare(draw(seed, chosen.trials), folder)
    for kind, count in score.items():
        print(f"{kind:20} {dict(count)}")
    for name, share in shares(score).items():
        print(f"{name:6} {100 * share:.1f} % (goal {100 * GOALS[name]:.0f} %)")


if __name__ == "__main__":
    main()
