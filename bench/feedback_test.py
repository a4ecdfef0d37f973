"""Is a loop seen where there is one, and nowhere else?  python -m bench.feedback_test N FIRST [DATA...]

With N seeds from FIRST on: `flysid.feedback` on open loops (linear and nonlinear plants of
`bench.verdict_fairness`; a quick attitude loop under smooth commands, logged slowly, with next to no noise,
and with a setpoint that is logged more slowly still and held),
and on closed ones (`bench.loop_bands`, by the strength of the gusts that the controller has to answer), also
where the log holds the input.

Of ingested folders: every pair that `flysid ls --suggest` calls good or closed loop, what `flysid tf` says of
the same pair, and how many of them do not agree.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from bench.loop_bands import flown
from bench.verdict_fairness import TRAIN, Plant, flights, linear_plant, nonlinear_dynamics
from flysid.dataset import Dataset
from flysid.feedback import feedback
from flysid.ingest.align.align import align
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.lake.suggest import suggest
from flysid.model.transfer_function import TF
from flysid.validate.transfers.identify import identify_channel

KINDS = ("saturation", "dead band", "drag")
NOISES = (0.002, 0.02, 0.1)
LOG_HZ = (10, 20, 50)
VEHICLE_HZ = 400
SMOOTH_HZ = (0.3, 1.0, 3.0)
QUICK = 10.0  # rad/s
SECONDS = 60
FAINT = 1e-3  # noise over the output's spread
HELD = (2, 5)  # samples for which a log holds an input


def slow_log(seed: int, log_hz: int, smooth_hz: float, *, noise: float = FAINT, held: int = 1) -> Dataset:
    """An attitude loop of 10 rad/s in open loop, under noise of this bandwidth, a few samples a second.

    `held`: samples for which the log holds the command.
    """
    rng = np.random.default_rng(seed)
    dt = 1.0 / VEHICLE_HZ
    pole = np.exp(-2.0 * np.pi * smooth_hz * dt)
    u = lfilter([1.0], np.poly([pole, pole]), rng.standard_normal(VEHICLE_HZ * SECONDS))
    u = u / u.std()
    poles = np.exp(QUICK * np.array([-0.7 + 0.714j, -0.7 - 0.714j]) * dt)
    a = np.real(np.poly(poles))
    y = lfilter([0.0, a.sum()], a, u)
    y = y + noise * y.std() * rng.standard_normal(len(y))
    every = VEHICLE_HZ // log_hz
    return hold(Dataset.from_arrays(u[::every], y[::every], every * dt), held)


def trials(count: int, first: int) -> Iterator[str]:
    """A line per kind of loop."""
    seeds = range(first, first + count)

    def seen(what: str, sets: list[Dataset]) -> str:
        return f"{what}: seen in {sum(feedback(d)[0].closed for d in sets)} of {len(sets)}"

    yield seen("open, linear", [_flights_of(linear_plant(_rng(s)), s) for s in seeds])
    for noise in NOISES:
        plants = [
            (Plant(kind, nonlinear_dynamics(kind, _rng(s)), noise, 0.0), s) for kind in KINDS for s in seeds
        ]
        yield seen(f"open, nonlinear, noise of {noise}", [_flights_of(p, s) for p, s in plants])
    for hertz in LOG_HZ:
        logs = [slow_log(s, hertz, smooth) for smooth in SMOOTH_HZ for s in seeds]
        yield seen(f"open, quick and smooth, logged at {hertz} Hz", logs)
    for held in HELD:
        for noise in (FAINT, NOISES[1]):
            logs = [slow_log(s, 50, smooth, noise=noise, held=held) for smooth in SMOOTH_HZ for s in seeds]
            yield seen(f"open, setpoint held for {held} samples of 50 Hz, noise of {noise}", logs)
    for gusts in (0.0, 0.1, 0.3, 1.0, 3.0):
        loops = [flown(_rng(s), gusts)[0] for s in seeds]
        yield seen(f"closed, gusts of {gusts}", loops)
        for held in HELD:
            logs = [hold(data, held) for data in loops]
            yield seen(f"closed, gusts of {gusts}, input held for {held} samples", logs)


def hold(data: Dataset, samples: int) -> Dataset:
    """The same where the log gets the input every so many samples only."""
    held = [np.repeat(s.u[::samples], samples, axis=0)[: len(s)] for s in data.segments]
    return Dataset.from_arrays(held, [s.y for s in data.segments], data.dt_s)


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def _flights_of(plant: Plant, seed: int) -> Dataset:
    return flights(plant, TRAIN, np.random.default_rng([seed, 1]), "t")


def pairs(folders: list[Path]) -> Iterator[str]:
    """A line per pair, then the sum."""
    count = without = unseen = untold = 0
    for log in (log for folder in folders for log in open_lake(folder).logs):
        for told in suggest([log]):
            if told.verdict not in ("good", "closed loop"):
                continue
            data = align([log], load_recipe(told.recipe), told.channel).dataset
            output = [s.name for s in data.outputs].index(told.output)
            found = identify_channel(told.channel, data, TF())
            band = found.band(output, [s.name for s in data.inputs].index(told.input))
            looped = found.is_looped(output)
            count += 1
            without += told.verdict == "good" and band is None
            unseen += told.feedback and not looped
            untold += looped and not told.feedback
            within = f"{band[0]:.3g} to {band[1]:.3g} rad/s" if band else "no band"
            yield (
                f"{log.name:36s} {told.channel:14s} {told.verdict:11s} "
                f"{'loop' if told.feedback else '':4s} tf: "
                f"{'a loop' if looped else 'open'}, {within}"
            )
    yield f"{count} pairs; good, and no band in tf {without}; loop in ls alone {unseen}, in tf alone {untold}"


def main(words: list[str]) -> int:
    """Print the lines asked for."""
    count, first, *folders = words
    lines = pairs([Path(f) for f in folders]) if folders else trials(int(count), int(first))
    for line in lines:
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
