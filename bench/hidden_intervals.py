"""Do intervals of rules over hidden states hold the truth? python -m bench.hidden_intervals [COUNT] [FIRST]

Two rules over the output and a hidden state are simulated under random steps, coloured noise (AR(1), 0.8) is
added, the numbers are refined on that record from the truth, and the intervals of the refit at its operating
points are asked whether the truth lies inside. Single consequents hang on what the hidden state means, and
rules' own gains have no intervals.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from bench.hidden_plants import PLANTS
from bench.ts_intervals import steps
from flysid.dataset import Dataset, FloatArray
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.free_run_error import Body
from flysid.model.rules.likely_start import LikelyStart, initial_states
from flysid.model.rules.local_models import SteadyMap
from flysid.model.rules.operating_points import describe, walked
from flysid.model.rules.regressor_layout import runs_of
from flysid.model.rules.rule_uncertainty import uncertainty
from flysid.model.rules.stages import Stage
from flysid.model.rules.state_systems import hold_still
from flysid.model.ts_state_space import TSStateSpace

NOISE = 0.02  # of the driving noise, in metres per second
SCALE = 0.35  # of the steps, in radians: the range of training


def known_model() -> FittedTS:
    """What two rules make of the vehicle with drag and a lagging actuator."""
    data, _ = PLANTS["vehicle with drag and a lagging actuator"].dataset((1, 2), 500, 0.02)
    return TSStateSpace(states=2, rules=2, nk=1, ridge=0.1, antecedents=("y(k-1)",)).fit(data)


def experiment(truth: FittedTS, seed: int) -> Dataset:
    """The truth's output with coloured noise."""
    u = SCALE * steps(100 + seed)
    noise = lfilter([1.0], [1.0, -0.8], NOISE * np.random.default_rng(seed).standard_normal(len(u)))
    y = truth.simulate(u) + np.asarray(noise)[:, None]
    data = Dataset.from_arrays(u, y, truth.dt_s)
    return replace(data, inputs=truth.inputs, outputs=truth.outputs)


def refitted(truth: FittedTS, data: Dataset) -> FittedTS:
    """The truth's numbers refined on one record."""
    layout = truth.layout
    p = truth.parameters
    runs = runs_of(layout, data.segments, truth.n_init + 2)
    problem = hold_still(layout, runs, p.z_range, p.limits)
    body = Body(p.theta.copy(), p.centre.copy(), p.width.copy())
    assert isinstance(truth.start, LikelyStart)
    stage = Stage(problem, body, initial_states(layout, runs, p, truth.start.prior, 400), np.inf)
    stage = stage.refined(40, 1e-10)
    return replace(truth, parameters=stage.problem.parameters(stage.body))


def true_gain(truth: FittedTS, level: float) -> float:
    """The steady gain of the truth where its output rests at a level."""
    layout = truth.layout
    way = np.linspace(layout.shift[0], level, 9)
    places = walked(SteadyMap(layout, truth.parameters), 0, 0, np.unique(way))
    return float(places[level].tangent.gain[0, 0] * layout.scale[0] / layout.scale[layout.n])


def coverage(experiments: int, first: int = 0) -> dict[str, float]:
    """Share of gains at operating points, and of simulated samples, whose 95 % interval holds the truth."""
    truth = known_model()
    fresh = SCALE * steps(99, 300)
    clean: FloatArray = truth.simulate(fresh)
    held: dict[str, list[float]] = {"gains": [], "simulation": []}
    for seed in range(first, first + experiments):
        data = experiment(truth, seed)
        model = describe(refitted(truth, data), data, settled=True)
        for p in model.operating_points:
            low, high = p.gain_interval[:, 0]
            held["gains"].append(float(low <= true_gain(truth, float(p.outputs[0])) <= high))
        below, above = uncertainty(model, data).simulation_band(fresh)
        held["simulation"].append(float(((below <= clean) & (clean <= above))[5:].mean()))
    return {name: float(np.mean(values)) for name, values in held.items()}


def main() -> None:
    """Print the coverage."""
    experiments = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    for name, share in coverage(experiments, first).items():
        print(f"{name:15s} {100 * share:.1f} % ({experiments} experiments, nominal 95 %)")


if __name__ == "__main__":
    main()
