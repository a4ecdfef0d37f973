"""Designed gains on vehicles that are not the one modelled.

`python -m bench.design FOLDER [VEHICLES] [SEED...]`

For every seed: the demo's twelve flights, its models of both tilts, a design from the published gains of
tum_ardrone, and trial flights of it. Runs that stand in FOLDER already are used again. Trial vehicles are
drawn from seeds of their own. Where the steady wind along an axis is more than the vehicle's full tilt holds,
no gains keep the position; what became of the others is told apart ("holdable").
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

from flysid.cli.demo import HOLDOUT, RECIPE, Stages, fly, take_in
from flysid.design.campaign import Campaign, fly_design
from flysid.design.designing import Wish, design_run
from flysid.design.firmware import SCHEMES, Firmware
from flysid.design.trialflight import Doubtful, Trial, held_wind_m_s
from flysid.errors import FlysidError
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.synth.rigid_body import SimulatedVehicle
from flysid.validate.runs.fitting import fit_run
from flysid.validate.runs.run import FitSettings, Run, open_run

CHANNELS = ("longitudinal", "lateral")
TRIALS_FROM = 900_000
LAWS = ("present_x2", "next", "goal")
DRAWN = 10_000
"""Vehicles of which the share in too much wind is counted; they are not flown."""


def run_of(folder: Path, seed: int) -> Run:
    """The demo's run of a seed, both tilts alone."""
    stages = Stages(folder / f"seed{seed}")
    if not stages.run.is_dir():
        stages.root.mkdir(parents=True, exist_ok=True)
        fly(stages, "ardrone", seed)
        take_in(stages)
        settings = FitSettings(seed=seed, holdout=HOLDOUT, channels=CHANNELS)
        fit_run(open_lake(stages.data), RECIPE, stages.run, settings, jobs=1)
    return open_run(stages.run)


def main(arguments: list[str]) -> int:
    """Print a table a seed and one over all."""
    folder = Path(arguments[0])
    vehicles = int(arguments[1]) if len(arguments) > 1 else 100
    seeds = [int(a) for a in arguments[2:]] or [41, 42, 43]
    limit = math.degrees(SimulatedVehicle().loop.tilt_max_rad)
    scheme = SCHEMES["tum-ardrone"][0]
    published = Firmware("tum-ardrone", scheme, limit=limit).gains(scheme.published)
    old = {"position": published.position, "velocity": published.velocity}
    campaigns: list[Campaign] = []
    for seed in seeds:
        run = run_of(folder, seed)
        started = time.process_time()
        try:
            design = design_run(run, Wish(CHANNELS, old=old, limit=limit))
        except FlysidError as error:
            print(f"seed {seed}: refused: {error.message}")
            continue
        spent = time.process_time() - started
        for name, (why, _) in design.refused.items():
            print(f"seed {seed}: {name} refused: {why}")
        campaigns.append(fly_design(design.axes, vehicles, TRIALS_FROM + seed, Doubtful()))
        print(
            f"seed {seed}: {vehicles} vehicles; design {spent:.1f} s of CPU; {'; '.join(campaigns[-1].notes)}"
        )
        for axis in campaigns[-1].rows:
            for row in campaigns[-1].table(axis):
                print(f"  {axis} " + " | ".join(row))
        for axis in campaigns[-1].rows:
            print_holdable([campaigns[-1]], axis)
    print_all(campaigns)
    return 0


def holdable(seed: int, vehicles: int, axis: str) -> npt.NDArray[np.bool_]:
    """(vehicles,) whether full tilt of each holds the steady wind along the axis."""
    trials = [Trial.drawn(Doubtful(), seed, i) for i in range(vehicles)]
    turn = {"x": math.cos, "y": math.sin}[axis]
    along = [abs(t.wind.speed_m_s * turn(math.radians(t.wind.towards_deg))) for t in trials]
    return np.array(along) <= [held_wind_m_s(t.vehicle)[axis] for t in trials]


def print_holdable(campaigns: list[Campaign], axis: str) -> None:
    """Of the vehicles in wind that they can hold, and how many are in more."""
    kept = np.concatenate([holdable(c.seed, c.vehicles, axis) for c in campaigns])
    told = []
    for law in LAWS:
        own, present = (
            np.array([f[axis].ise for c in campaigns for f in c.flown[name]]) for name in (law, "present")
        )
        less, more = (100.0 * np.mean(good[kept]) for good in (own <= 0.8 * present, own > present))
        told.append(f"{law} {less:.1f} % (worse {more:.1f} %)")
    print(f"  {axis} holdable, {kept.sum()} of {len(kept)}: >= 20 % less on {'; '.join(told)}")


def print_all(campaigns: list[Campaign]) -> None:
    """Every vehicle of every run in one."""
    for axis in ("x", "y"):
        own = {
            law: np.array([f[axis].ise for c in campaigns for f in c.flown[law]])
            for law in ("present", *LAWS)
        }
        for law in LAWS:
            rows = [r for c in campaigns for r in c.rows[axis] if r.law == law]
            less = 100.0 * np.mean(own[law] <= 0.8 * own["present"])
            beside = 100.0 * (np.median(own[law]) / np.median(own["present_x2"]) - 1.0)
            print(
                f"{axis} {law}: >= 20 % less on {less:.1f} %; worse on "
                f"{100.0 * np.mean(own[law] > own['present']):.1f} %; median {np.median(own[law]):.1f}, "
                f"{beside:+.0f} % of twice the present; true Ms at most {max(r.ms[1] for r in rows):.2f}; "
                f"saturated {100.0 * np.mean([r.saturated for r in rows]):.0f} %; "
                f"lost {sum(r.lost for r in rows)}; blown off {sum(r.blown for r in rows)}"
            )
        print_holdable(campaigns, axis)
        share = 100.0 * holdable(TRIALS_FROM, DRAWN, axis).mean()
        print(f"  {axis}: full tilt holds the steady wind of {share:.1f} % of {DRAWN} drawn vehicles")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
