"""Gains of rules and a self-tuning PD beside the robust PID, on vehicles that are not the one modelled.

`python -m bench.rule_gains FOLDER [VEHICLES] [SEED...]`: runs and vehicles of `bench.design`, with 0 vehicles
what the models say alone, also of rules whose consequents are fitted again locally; the gains of
rules (parallel distributed compensation) and the PDs fly forwards, the PID sideways. The PDs keep the PID's
bounds on every plant, the self-tuning one at both ends and in the middle of its gains; what is free in them
is sought on drawn vehicles of a seed of their own, which favours them: the PID and the rules saw the models
alone.
"""

from __future__ import annotations

import math
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
from scipy.optimize import differential_evolution

from bench.design import TRIALS_FROM, run_of
from flysid.dataset import FloatArray
from flysid.design.designing import Ready, Wish, design_run, ready_channel
from flysid.design.drawn_plants import PlantSet, grid
from flysid.design.firmware import SCHEMES, Firmware
from flysid.design.gain_search import OUT_OF_BOUNDS, Bounds
from flysid.design.law import Gains, LoopParts
from flysid.design.loopfigures import Figures, Laws, figures
from flysid.design.rule_gains import law_figures, search_rule_gains
from flysid.design.rule_plants import rule_plant
from flysid.design.self_tuning import Tuner
from flysid.design.trialflight import PERIOD_S, Doubtful, Trial, fly_trial, true_plants
from flysid.errors import FlysidError
from flysid.ingest.synth.rigid_body import SimulatedVehicle
from flysid.model.rules.consequents import refit_consequents
from flysid.model.rules.rule_model import RuleModel
from flysid.validate.runs.run import held_out

CHANNELS = ("longitudinal", "lateral")
LIMIT = math.degrees(SimulatedVehicle().loop.tilt_max_rad)
SOUGHT_FROM = 800_000
SOUGHT_ON = 6
PLACEHOLDER = Gains(1.0, 1.0)
"""A law whose gains a tuner sets."""


def sought_tuner(plants: PlantSet, bounds: Bounds, other: Gains, seed: int, *, fixed: bool) -> Tuner:
    """The ends and spans of least median ISE within the bounds; `fixed` leaves both ends of a gain equal.

    Parameters
    ----------
    other : law of the axis that is not judged.
    """
    trials = [Trial.drawn(Doubtful(), SOUGHT_FROM + seed, i) for i in range(SOUGHT_ON)]
    parts = LoopParts.at(plants.omega, plants.dt_s)

    def of(x: FloatArray) -> Tuner:
        v = [float(value) for value in np.exp(x)]
        share, kept = (v[2], v[3]) if len(v) > 2 else (1.0, 1.0)
        spans = (v[4], v[5]) if len(v) > 2 else (1.0, 1.0)
        return Tuner((share * v[0] * v[1], v[0] * v[1]), (kept * v[1], v[1]), *spans)

    def cost(x: FloatArray) -> float:
        tuner = of(x)
        over = bounds.excess(tuner_figures(tuner, plants, parts)).max()
        if over > 0.0:
            return float(OUT_OF_BOUNDS * (1.0 + over))
        flown = [fly_trial(t, (PLACEHOLDER, other), Doubtful(), tuners=(tuner, None))["x"] for t in trials]
        return float(np.median([f.ise for f in flown]))

    free = [(0.3, 5.0), (2.0, bounds.noise)]
    if not fixed:
        free += [(0.1, 1.0), (0.1, 1.0), (0.3, 5.0), (0.3, 5.0)]
    limits = np.log(free)
    found = differential_evolution(
        cost, limits, rng=seed, popsize=6, maxiter=8, init="sobol", polish=False, tol=1e-3
    )
    return of(found.x)


def tuner_figures(tuner: Tuner, plants: PlantSet, parts: LoopParts) -> Figures:
    """Of the laws between which the gains move, each standing still."""
    laws = tuner.laws()
    return figures(Laws.of(laws[0], np.array([law.tuned() for law in laws])), plants.responses, parts)


def print_local(model: RuleModel, ready: Ready) -> None:
    """What becomes of the rules' gains where every rule is fitted to its own neighbourhood."""
    local = refit_consequents(model, ready.data.train, criterion="local", ridge="auto")
    try:
        law = search_rule_gains(rule_plant(local), ready.plants, ready.bounds, LIMIT)
    except FlysidError as error:
        print(f"  local rules: {error.message}")
        return
    found = law_figures(law, ready.plants, LoopParts.at(ready.plants.omega, ready.plants.dt_s))
    print(
        f"  local rules: Ms {found.ms.max():.2f}, noise {found.noise.max():.1f}, "
        f"tracking {found.tracking.max():.2f}"
    )


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
        found = law_figures(law, ready.plants, LoopParts.at(ready.plants.omega, ready.plants.dt_s))
        pid = axes[CHANNELS[0]].meanings["goal"]
        print(
            f"seed {seed}: {len(law.gains)} rules, {law.plant.order} states, {spent:.1f} s of CPU; "
            f"on the models: Ms {found.ms.max():.2f}, peak {found.peak.max():.2f}, "
            f"noise {found.noise.max():.1f}, tracking {found.tracking.max():.2f}; "
            f"PID: Ms {pid.ms[1]:.2f}, peak {pid.peak[1]:.2f}, "
            f"noise {pid.noise[1]:.1f}, tracking {pid.tracking[1]:.2f}"
        )
        x = axes[CHANNELS[0]].laws["goal"]
        if not vehicles:
            print_local(cast(RuleModel, item.models["ts"]), ready)
            continue
        y = axes[CHANNELS[1]].laws["goal"] if CHANNELS[1] in axes else published
        trials = [Trial.drawn(Doubtful(), TRIALS_FROM + seed, i) for i in range(vehicles)]
        omega = grid(PERIOD_S)
        true = np.array([true_plants(t.vehicle, omega)["x"] for t in trials])
        parts = LoopParts.at(omega, PERIOD_S)
        margins = law_figures(law, replace(ready.plants, responses=true, omega=omega), parts)
        pd = {
            name: sought_tuner(ready.plants, ready.bounds, y, seed, fixed=name == "fixed PD")
            for name in ("fixed PD", "self-tuning PD")
        }
        for name, tuner in pd.items():
            told = tuner_figures(tuner, ready.plants, LoopParts.at(ready.plants.omega, ready.plants.dt_s))
            print(f"  {name}: {tuner}; on the models: Ms {told.ms.max():.2f}, noise {told.noise.max():.1f}")
        rows = {
            "published": [fly_trial(t, (published, y), Doubtful())["x"] for t in trials],
            "PID": [fly_trial(t, (x, y), Doubtful())["x"] for t in trials],
            "rules": [fly_trial(t, (x, y), Doubtful(), (law, None))["x"] for t in trials],
        }
        for name, tuner in pd.items():
            rows[name] = [
                fly_trial(t, (PLACEHOLDER, y), Doubtful(), tuners=(tuner, None))["x"] for t in trials
            ]
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
        for name, tuner in pd.items():
            own = tuner_figures(tuner, replace(ready.plants, responses=true, omega=omega), parts).ms
            print(f"  true Ms of the {name}, gains standing still: at most {own.max():.2f}")
        print(
            f"  true Ms of the rules' gains: median {np.median(margins.ms):.2f}, at most "
            f"{margins.ms.max():.2f}; stable on all: {bool(margins.stable.all())}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
