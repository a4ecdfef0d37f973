"""What the floor for delays does to rules: python -m bench.delay_floor FIRST LAST

The simulated quadrotor's lateral axis, whose link is 40 ms late: `TS` with and without the least delay that
the log shows, fitted to four flights, judged on two more; and how much of its final answer a step shows in
its first three samples, before the vehicle can have heard of it.
"""

from __future__ import annotations

import argparse

import numpy as np

from bench.rule_words import FLIGHTS, TRAINED, specimen, vehicle_flights
from flysid.dataset import Dataset
from flysid.ingest.excitation.dead_time import dead_times, delays_to_try, least_delays
from flysid.model.rules.rule_model import RuleModel
from flysid.model.ts import TS, over_lags

STARTED = 100
SETTLED = 800
EARLY = 3


def free_run_error(model: RuleModel, data: Dataset) -> float:
    """RMSE behind the first two seconds."""
    runs = [(model.simulate(s.u, s.y[: model.n_init]) - s.y)[STARTED:] for s in data.segments]
    return float(np.sqrt(np.mean(np.concatenate(runs) ** 2)))


def early_share(model: RuleModel) -> float:
    """The largest answer in the first samples of a small step from rest, over the final one."""
    u = np.zeros((2 * SETTLED, 1))
    rest = model.simulate(u)
    u[SETTLED:] = 0.01
    answer = (model.simulate(u) - rest)[SETTLED:, 0]
    return float(np.abs(answer[:EARLY]).max() / abs(answer[-1]))


def main() -> None:
    """Print two lines a seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int, help="not flown any more")
    asked = parser.parse_args()
    for seed in range(asked.first, asked.last):
        vehicle = specimen(seed)
        train = vehicle_flights(vehicle, "lateral", seed, range(TRAINED))
        test = vehicle_flights(vehicle, "lateral", seed, range(TRAINED, len(FLIGHTS)))
        late = dead_times(train)
        for floor in ((), least_delays(late, 1)):
            model = over_lags(TS(nk_hint=delays_to_try(late, 1), nk_least=floor), train)
            said = f"{model.layout.orders}, {len(model.rules())} rules: {free_run_error(model, test):.4f} m/s"
            print(f"{seed} floor {floor}: {said}, early {100 * early_share(model):.2f} %", flush=True)


if __name__ == "__main__":
    main()
