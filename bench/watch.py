"""`python -m bench.watch [--small] [--models arx,ts]`: false alarms, and how soon faults are found.

A simulated quadrotor (50 Hz, wind of 0 to 4 m/s drawn for each flight, turbulence, sensor noise) is
identified on 8 flights of 150 s; thresholds come from 4 h of other flights, false alarms are counted in fresh
ones, and faults come at 60 s of 120, or are there from take-off. Seeds of the four sets are disjoint, and
those of campaigns (`--campaign`), too. The watch begins 10 s after a flight does: the simulated vehicle
starts trimmed for still air, and real wind does not come within one sample.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

import flysid
from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.ingest.synth.dryden import Wind, wind_field
from flysid.ingest.synth.plans import GENTLE, MULTISINE, PILOT, STEPS
from flysid.ingest.synth.rigid_body import SimulatedVehicle, fly_vehicle
from flysid.live.watching import ChannelWatch, known_inputs
from flysid.model.base import Fitted
from flysid.validate.diagnose.detect import DETECTORS, calibrate

PERIOD_S = 0.02
ALTITUDE_M = 60.0
TRAINING_S = 150.0
FAULT_S = 120.0
AT_S = 60.0
SETTLING_S = 10.0
ASKED_1_H = 0.1
CAMPAIGN = 1_000_000
NOISE = {"thrust": 0.005, "v_z": 0.02, "q": 0.3, "r": 0.3}
PLANS = (MULTISINE, PILOT, STEPS)
DRONE = SimulatedVehicle()
SIGNALS = {
    "thrust": Signal("thrust"),
    "v_z": Signal("v_z", "m/s"),
    "vz_in": Signal("vz_in", "m/s"),
    "q": Signal("q", "deg/s"),
    "r": Signal("r", "deg/s"),
    "pitch_torque": Signal("pitch_torque", "mN m"),
    "yaw_torque": Signal("yaw_torque", "mN m"),
}
CHANNELS = {
    "thrust": ("vz_in", "thrust"),
    "pitch": ("pitch_torque", "q"),
    "yaw": ("yaw_torque", "r"),
    "vertical": ("vz_in", "v_z"),
}
TORQUES = ("pitch", "yaw")
SAID = ("alarm", "outside")


def faulty(load: float = 1.0, rotor_1: float = 1.0) -> SimulatedVehicle:
    """The drone with another load or a weaker front rotor."""
    return replace(DRONE, airframe=replace(DRONE.airframe, load=load, rotor_1=rotor_1))


FAULTS = {
    "mass +20 %": faulty(load=1.2),
    "mass +5 %": faulty(load=1.05),
    "motor -15 %": faulty(rotor_1=0.85),
    "motor -3 %": faulty(rotor_1=0.97),
}


@dataclass(frozen=True)
class Flown:
    """What is measured in a flight, by name."""

    values: dict[str, FloatArray]
    name: str

    def segment(self, channel: str) -> Segment:
        """One channel's input and output."""
        u, y = CHANNELS[channel]
        return Segment(self.values[u][:, None], self.values[y][:, None], flight=self.name)


def fly(seed: int, seconds: float, fault: tuple[float, SimulatedVehicle] | None = None) -> Flown:
    """One flight; the seed draws its plan, its wind and its noise."""
    rng = np.random.default_rng([seed, 25])
    settling = round(SETTLING_S / PERIOD_S)
    t = np.arange(settling + round(seconds / PERIOD_S), dtype=np.float64) * PERIOD_S
    plan = PLANS[seed % len(PLANS)]
    command = plan.command(t, GENTLE, rng)
    wind = Wind(float(rng.uniform(0.0, 4.0)), float(rng.uniform(0.0, 360.0)))
    field = wind_field(wind, len(t), PERIOD_S, ALTITUDE_M, rng)
    drone = DRONE
    if fault is not None:
        at_s, vehicle = fault
        fault = (SETTLING_S + at_s, vehicle) if at_s else None
        drone = DRONE if at_s else vehicle
    flown = fly_vehicle(drone, command, wind_m_s=field, start=drone.hover(ALTITUDE_M), fault=fault)
    series = flown.series()
    squares = flown.states[:, 12:16] ** 2
    frame = DRONE.airframe
    true = {
        "vz_in": command[:, 2],
        "thrust": series["thrust"],
        "v_z": series["vz"],
        "q": series["q"],
        "r": series["r"],
        "pitch_torque": 1e3 * frame.arm_m * frame.thrust_factor * (squares[:, 2] - squares[:, 0]),
        "yaw_torque": 1e3 * frame.torque_factor * (squares @ np.array([1.0, -1.0, 1.0, -1.0])),
    }
    noisy = {name: x + NOISE.get(name, 0.0) * rng.standard_normal(len(x)) for name, x in true.items()}
    return Flown({name: x[settling:] for name, x in noisy.items()}, f"flight-{seed}")


def dataset(channel: str, flights: list[Flown]) -> Dataset:
    """Flights as a channel's dataset."""
    u, y = CHANNELS[channel]
    segments = tuple(flight.segment(channel) for flight in flights)
    return Dataset(PERIOD_S, (SIGNALS[u],), (SIGNALS[y],), segments, channel)


def fitted(kind: str, data: Dataset) -> Fitted:
    """A model of the channel."""
    estimator = flysid.ARX() if kind == "arx" else flysid.TS()
    return estimator.fit(data)


def watch(channel: str, model: Fitted, training: list[Flown], others: list[Flown]) -> ChannelWatch:
    """The channel's watch, at its share of the vehicle's false alarms."""
    share = ASKED_1_H / len(CHANNELS) / len(DETECTORS)
    known = known_inputs([f.segment(channel) for f in training])
    limits = calibrate(model, [f.segment(channel) for f in others], share)
    return ChannelWatch(channel, model, limits, known)


def first_events(
    watches: list[ChannelWatch], flown: Flown, after_s: float
) -> Iterator[tuple[str, str, float]]:
    """(channel, kind, seconds from `after_s` on) of each channel's first alarm and first "outside"."""
    for one in watches:
        events = [e for e in one.run(flown.segment(one.name)) if e.time_s >= after_s]
        for kind in SAID:
            times = [e.time_s - after_s for e in events if e.kind == kind]
            if times:
                yield one.name, kind, times[0]


def seeds(first: int, count: int) -> Iterator[int]:
    return iter(range(first, first + count))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--models", default="arx,ts")
    parser.add_argument(
        "--hours", type=float, default=10.0, help="of nominal flight for false alarms; 0: none"
    )
    parser.add_argument("--calibration-hours", type=float, default=4.0)
    parser.add_argument("--faults", type=int, default=40, help="flights for each fault")
    parser.add_argument("--only", default="", help="faults whose names begin so, e.g. motor")
    parser.add_argument(
        "--at",
        nargs="*",
        choices=["60", "0"],
        default=["60", "0"],
        help="s when a fault comes; 0: from take-off",
    )
    parser.add_argument("--channels", default=",".join(CHANNELS))
    parser.add_argument("--campaign", type=int, default=0, help="another has other seeds for everything")
    parser.add_argument("--small", action="store_true", help="a tenth of everything")
    options = parser.parse_args()
    share = 0.1 if options.small else 1.0
    flights_an_hour = 3600.0 / TRAINING_S
    first = CAMPAIGN * options.campaign
    held = round(share * options.calibration_hours * flights_an_hour)
    training = [fly(seed, TRAINING_S) for seed in seeds(first + 1_000, 8)]
    others = [fly(seed, TRAINING_S) for seed in seeds(first + 2_000, held)]
    nominal = [
        fly(s, TRAINING_S) for s in seeds(first + 20_000, round(share * options.hours * flights_an_hour))
    ]
    faults = max(4, round(share * options.faults))
    for kind in options.models.split(","):
        began = time.process_time()
        watches = [
            watch(c, fitted(kind, dataset(c, training)), training, others)
            for c in options.channels.split(",")
        ]
        print(f"\n## {kind}\n\n(fitted and calibrated in {time.process_time() - began:.0f} s of CPU)\n")
        if nominal:
            false_alarms(watches, nominal)
        if "60" in options.at:
            delays(watches, faults, "comes at 60 s", AT_S, options.only, first)
        if "0" in options.at:
            delays(watches, max(4, faults // 2), "from take-off", 0.0, options.only, first)


def false_alarms(watches: list[ChannelWatch], nominal: list[Flown]) -> None:
    """False alarms by channel and detector, with the exact 95 % bound of their rate."""
    hours = len(nominal) * TRAINING_S / 3600.0
    total = 0
    began = time.process_time()
    samples = 0
    print(f"Nominal flight, {hours:.1f} h, {ASKED_1_H:g}/h asked for (the vehicle's):\n")
    print("| channel | " + " | ".join(DETECTORS) + " | outside, share of samples |\n|---" + "|---" * 4 + "|")
    for one in watches:
        events = [e for flown in nominal for e in one.run(flown.segment(one.name))]
        counts = [sum(e.kind == "alarm" and e.detector == d for e in events) for d in DETECTORS]
        u = np.concatenate([flown.segment(one.name).u for flown in nominal])
        outside = float(((u < one.known[0]) | (u > one.known[1])).any(axis=1).mean())
        total += sum(counts)
        samples += len(u)
        print(f"| {one.name} | " + " | ".join(map(str, counts)) + f" | {100 * outside:.2g} % |")
    bound = stats.chi2.ppf(0.95, 2 * total + 2) / 2 / hours
    spent = 1e6 * (time.process_time() - began) / samples
    print(f"\n{total} false alarms in {hours:.1f} h: {total / hours:.2g}/h, at most {bound:.2g}/h with 95 %")
    print(f"({spent:.1f} us of CPU a sample and channel, three detectors)\n")


def delays(watches: list[ChannelWatch], count: int, when: str, at_s: float, only: str, first: int) -> None:
    """Which share of flights with a fault each channel finds, and how soon."""
    print(f"\nFault {when}, {count} flights each; found, median / 95th percentile in s:\n")
    names = [one.name for one in watches]
    print("| fault | " + " | ".join(names) + " |\n|---" + "|---" * len(names) + "|")
    for k, (fault, vehicle) in enumerate(FAULTS.items()):
        if not fault.startswith(only):
            continue
        found: dict[tuple[str, str], list[float]] = {(name, kind): [] for kind in SAID for name in names}
        for seed in seeds(first + 200_000 + 1_000 * k, count):
            flown = fly(seed, FAULT_S, (at_s, vehicle))
            for name, said, delay in first_events(watches, flown, at_s):
                found[name, said].append(delay)
        for kind in SAID:
            cells = [cell(found[name, kind], count) for name in names]
            print(f"| {fault}, {kind} | " + " | ".join(cells) + " |")


def cell(delays_s: list[float], count: int) -> str:
    """Share found, and the delays over all flights: those that were not found count as never."""
    if not delays_s:
        return "0"
    every = np.sort([*delays_s, *[np.inf] * (count - len(delays_s))])
    middle, late = (every[min(count - 1, int(np.ceil(q * count)) - 1)] for q in (0.5, 0.95))
    return f"{100 * len(delays_s) / count:.0f} %, {middle:.2f} / {late:.2f}"


if __name__ == "__main__":
    main()
