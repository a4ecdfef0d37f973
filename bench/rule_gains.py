"""Gains of rules (parallel distributed compensation) beside the robust PID, on vehicles not the modelled one.

`python -m bench.rule_gains FOLDER [VEHICLES] [SEED...]`: runs and vehicles of `bench.design`; the rules'
gains fly forwards, the PID sideways, as in the table's other rows.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.design import TRIALS_FROM, run_of
from flysid.design.designing import Wish, design_run, ready_channel
from flysid.design.drawn_plants import grid
from flysid.design.firmware import SCHEMES, Firmware
from flysid.design.law import Parts
from flysid.design.rule_gains import law_figures, search_rule_gains
from flysid.design.rule_plants import rule_plant
from flysid.design.trialflight import PERIOD_S, Doubtful, Trial, fly_trial, true_plants
from flysid.errors import FlysidError
from flysid.ingest.synth.rigid_body import Vehicle
from flysid.validate.run import held_out

CHANNELS = ("longitudinal", "lateral")
LIMIT = math.degrees(Vehicle().loop.tilt_max_rad)


def main(arguments: list[str]) -> int:
    """Print a table a seed."""
    folder = Path(arguments[0])
    vehicles = int(arguments[1]) if len(arguments) > 1 else 100
    scheme = SCHEMES["tum-ardrone"][0]
    published = Firmware("tum-ardrone", scheme, limit=LIMIT).gains(scheme.published)
    wish = Wish(CHANNELS, old={"position": published.position, "velocity": published.velocity}, limit=LIMIT)
    for seed in [int(a) for a in arguments[2:]] or [41, 42, 43]:
        run = run_of(folder, seed)
        only = replace(run, channels=tuple(c for c in run.channels if c.name == CHANNELS[0]))
        item = held_out(only)[0]
        try:
            axes = {a.channel: a for a in design_run(run, wish).axes}
            ready = ready_channel(item, wish)
            started = time.process_time()
            law = search_rule_gains(rule_plant(item.models["ts"]), ready.plants, ready.bounds, LIMIT)
        except FlysidError as error:
            print(f"seed {seed}: refused: {error.message}")
            continue
        spent = time.process_time() - started
        found = law_figures(law, ready.plants, Parts.at(ready.plants.omega, ready.plants.dt_s))
        pid = axes[CHANNELS[0]].meanings["goal"]
        print(
            f"seed {seed}: {len(law.gains)} rules, {law.plant.order} states, {spent:.1f} s of CPU; "
            f"on the models: Ms {found.ms.max():.2f}, peak {found.peak.max():.2f}, "
            f"noise {found.noise.max():.1f}, tracking {found.tracking.max():.2f}; "
            f"PID: Ms {pid.ms[1]:.2f}, peak {pid.peak[1]:.2f}, "
            f"noise {pid.noise[1]:.1f}, tracking {pid.tracking[1]:.2f}"
        )
        x = axes[CHANNELS[0]].laws["goal"]
        y = axes[CHANNELS[1]].laws["goal"] if CHANNELS[1] in axes else published
        trials = [Trial.drawn(Doubtful(), TRIALS_FROM + seed, i) for i in range(vehicles)]
        omega = grid(PERIOD_S)
        true = np.array([true_plants(t.vehicle, omega)["x"] for t in trials])
        parts = Parts.at(omega, PERIOD_S)
        margins = law_figures(law, replace(ready.plants, responses=true, omega=omega), parts)
        rows = {
            "published": [fly_trial(t, (published, y), Doubtful())["x"] for t in trials],
            "PID": [fly_trial(t, (x, y), Doubtful())["x"] for t in trials],
            "rules": [fly_trial(t, (x, y), Doubtful(), (law, None))["x"] for t in trials],
        }
        base = np.array([f.ise for f in rows["published"]])
        for name, flown in rows.items():
            ise = np.array([f.ise for f in flown])
            shares = [np.mean(ise <= 0.8 * base), np.median([f.overshoot for f in flown])]
            shares.append(np.mean([f.saturated for f in flown]))
            less, over, full = (100.0 * v for v in shares)
            print(
                f"  {name}: ISE {np.median(ise):.1f}, 90 % {np.quantile(ise, 0.9):.0f}; >= 20 % less on "
                f"{less:.0f} %; overshoot {over:.0f} %; "
                f"moves {np.median([f.moved for f in flown]):.0f} deg/s; saturated {full:.0f} %; "
                f"lost {sum(f.lost for f in flown)}; blown {sum(f.blown for f in flown)}"
            )
        print(
            f"  true Ms of the rules' gains: median {np.median(margins.ms):.2f}, at most "
            f"{margins.ms.max():.2f}; stable on all: {bool(margins.stable.all())}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
