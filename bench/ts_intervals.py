"""Do the intervals of a TS model hold the truth?  python -m bench.ts_intervals [EXPERIMENTS]

A known two-rule model is simulated under random steps, coloured noise (AR(1), 0.8) is added, the numbers are
refined on that record from the truth, and the intervals of the refit are asked whether the truth lies inside.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.growth import best_started
from flysid.model.rules.refit import as_problem
from flysid.model.rules.regressor_layout import runs_of
from flysid.model.rules.rule_uncertainty import uncertainty
from flysid.model.ts import TS, over_lags

DT_S = 0.05


def steps(seed: int, samples: int = 1500) -> FloatArray:
    """(N, 1) random steps held for ten samples."""
    return np.repeat(np.random.default_rng(seed).uniform(-1, 1, samples // 10), 10)[:, None]


@cache
def known_model() -> FittedTS:
    """Two rules over the input: slower and weaker below, faster and stronger above."""
    u = steps(0)
    y = lfilter([0.0, 0.3], [1.0, -0.7], u[:, 0])
    settings = TS(rules=2, na=1, nb=1, nk=1, antecedents=("u(k-1)",), iterations=3)
    fitted = over_lags(settings, Dataset.from_arrays(u, np.asarray(y), DT_S))
    parameters = fitted.parameters._replace(
        theta=np.array([[[0.8, 0.1, -0.1]], [[0.6, 0.4, 0.2]]]),
        centre=np.array([[-0.8], [0.8]]),
        width=np.array([[0.5], [0.5]]),
    )
    return replace(fitted, parameters=parameters)


def experiment(truth: FittedTS, seed: int) -> Dataset:
    """The truth's output with coloured noise."""
    u = steps(100 + seed)
    noise = lfilter([1.0], [1.0, -0.8], 0.03 * np.random.default_rng(seed).standard_normal(len(u)))
    y = truth.simulate(u, np.zeros((truth.n_init, 1))) + np.asarray(noise)[:, None]
    return Dataset.from_arrays(u, y, DT_S)


def refitted(truth: FittedTS, data: Dataset) -> FittedTS:
    """The truth's numbers refined on one record."""
    runs = runs_of(truth.layout, data.segments, truth.n_init + 2)
    problem, body = as_problem(truth.layout, truth.parameters, runs)
    stage = best_started(problem, body).refined(30, 1e-10)
    return replace(truth, parameters=stage.problem.parameters(stage.body))


def coverage(experiments: int) -> dict[str, float]:
    """Share of consequents, gains and simulated samples whose 95 % interval holds the truth."""
    truth = known_model()
    gain = np.array([rule.gain for rule in truth.local_polynomials()])
    fresh = steps(99, 300)
    clean = truth.simulate(fresh, np.zeros((truth.n_init, 1)))
    held: dict[str, list[float]] = {"consequents": [], "gains": [], "simulation": []}
    for seed in range(experiments):
        data = experiment(truth, seed)
        model = refitted(truth, data)
        sure = uncertainty(model, data)
        z = (model.consequents - truth.consequents) / sure.consequent_errors
        held["consequents"].append(float((np.abs(z) < 1.96).mean()))
        low, high = sure.gain_interval
        held["gains"].append(float(((low <= gain) & (gain <= high)).mean()))
        below, above = sure.simulation_band(fresh, clean[: truth.n_init])
        inside = (below <= clean) & (clean <= above)
        held["simulation"].append(float(inside[5:].mean()))
    return {name: float(np.mean(values)) for name, values in held.items()}


def main() -> None:
    """Print the coverage."""
    experiments = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    for name, share in coverage(experiments).items():
        print(f"{name:12s} {100 * share:.1f} % of 95 % intervals hold the truth ({experiments} experiments)")


if __name__ == "__main__":
    main()
