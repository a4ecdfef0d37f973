"""`python -m bench.review_faults [--seed N] [--trials 40] [--firmware NAME]`: is the first sentence right?

Quadrotors with one fault each and as many sound ones are flown in simulation and logged as ArduCopter, PX4,
Betaflight or INAV would; planes and rovers are drawn, and logged as ArduPlane and Rover would. A third of the
logs is made for tuning, a third holds what the firmware logs by default, a third lacks half of that. All are
reviewed. Of a faulty flight the first sentence must name the fault (goal 90 %); it is false where it
complains of something else (at most 2 %). A sound flight gets no action (95 %) and no complaint. Seeds are
new in each run, and printed.
"""

from __future__ import annotations

import argparse
import random
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import binomtest

import flysid
from bench.faulty_blackbox import blackbox_bytes
from bench.faulty_carriers import carrier_bytes, travel
from bench.faulty_dataflash import dataflash_bytes
from bench.faulty_kinds import CARRIERS, COPTERS, FAULTS, FIRMWARES, NEEDS, SHOWN, SOUND, draw_sound
from bench.faulty_logging import TUNING, Logging, draw_logging
from bench.faulty_quadrotor import RATE_HZ, Flight, Quadrotor, draw_quadrotor
from bench.faulty_sensors import fly
from bench.faulty_ulog import ulog_bytes
from flysid.ingest.align.signals import FlightLog
from flysid.reviews.fact import Grade
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.review import review_flight
from flysid.reviews.reviewed import NOTHING_FOUND, Review

BATCH = 16
GOALS = {"right": 0.90, "false": 0.02, "quiet": 0.95}
IMU_HZ = (25.0, 50.0, 100.0, 200.0)
"""Rates at which planes and rovers log their sensors."""


@dataclass(frozen=True)
class Trial:
    """One flight: what is wrong with it, who logs it, whether its ESCs state their speed, what is logged."""

    kind: str
    vehicle: Quadrotor
    firmware: str
    rpm: bool
    imu_hz: float = RATE_HZ
    logging: Logging = TUNING


def draw(seed: int, trials: int, firmwares: Sequence[str] = COPTERS) -> list[Trial]:
    """Trials of all kinds by turns, each of a firmware that shows it, and as many of sound vehicles."""
    rng = np.random.default_rng(seed)
    shown = [kind for kind in FAULTS if set(SHOWN.get(kind, FIRMWARES)) & set(firmwares)]
    kinds = [shown[i % len(shown)] for i in range(trials)] + [SOUND] * trials
    found = []
    for kind in kinds:
        spoilt = draw_sound(rng) if kind == SOUND else FAULTS[kind].spoil(draw_quadrotor(rng), rng)
        able = [name for name in firmwares if name in SHOWN.get(kind, FIRMWARES)]
        firmware = str(rng.choice(able))
        rate_hz = float(rng.choice(IMU_HZ)) if firmware in CARRIERS else RATE_HZ
        logging = draw_logging(rng, firmware, NEEDS.get(kind, ()))
        rpm = bool(rng.integers(2)) or "eRPM" in NEEDS.get(kind, ())
        found.append(Trial(kind, spoilt, firmware, rpm, rate_hz, logging))
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
        firmware = CARRIERS[trial.firmware]
        return carrier_bytes(flight, firmware, imu_hz=trial.imu_hz, logging=trial.logging)
    if trial.firmware in ("betaflight", "inav"):
        return blackbox_bytes(flight, trial.firmware, rpm=trial.rpm, logging=trial.logging)
    if trial.firmware == "px4":
        return ulog_bytes(flight, logging=trial.logging)
    return dataflash_bytes(flight, rpm=trial.rpm, logging=trial.logging)


def write(trial: Trial, flight: Flight, folder: Path, name: str) -> Path:
    """The file of a trial's log."""
    path = folder / f"{name}_{trial.firmware}{SUFFIXES.get(trial.firmware, '.bin')}"
    path.write_bytes(log_bytes(trial, flight))
    return path


def judge(trial: Trial, flight: Flight, found: Review) -> str:
    """ "right", "false" or "silent"; of a sound flight "false" where something is complained of."""
    first = found.findings[0]
    complains = first is not NOTHING_FOUND and first.grade.rank >= Grade.WATCH.rank
    leads = complains or first.grade is Grade.PLAIN
    if trial.kind != SOUND and leads and FAULTS[trial.kind].names(first.text, flight):
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
                logged = "for tuning" if trial.logging is TUNING else f"without {sorted(trial.logging.lacks)}"
                print(
                    f"{path.name}: {verdict}: {sentences} | {done} | {logged} | {spent_s:.2f} s", flush=True
                )
            for words in found.broken:
                print(f"{path.name}: {words}")
    return score


def counts(score: dict[str, Counter[str]]) -> dict[str, tuple[int, int]]:
    """n of N: faulty flights that are named, flights that are wronged, sound ones that are left alone."""
    faulty = sum((count for kind, count in score.items() if kind != SOUND), Counter[str]())
    sound = score.get(SOUND, Counter())
    n, m = (sum(of[v] for v in ("right", "false", "silent")) for of in (faulty, sound))
    return {
        "right": (faulty["right"], n),
        "false": (faulty["false"] + sound["false"], n + m),
        "quiet": (m - sound["action"], m),
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
    for name, (k, n) in counts(score).items():
        bounds = binomtest(k, max(n, 1)).proportion_ci(method="exact")
        share = f"{100 * k / max(n, 1):.1f} % [{100 * bounds.low:.1f}, {100 * bounds.high:.1f}]"
        print(f"{name:6} {k} of {n}: {share} (goal {100 * GOALS[name]:.0f} %)")


if __name__ == "__main__":
    main()
