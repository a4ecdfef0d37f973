"""How much luck flights of one real vehicle have: the spread of log error ratios between them.

`python -m bench.flight_luck [RATE_HZ]`: ten flights of one quadrotor (../shared/logs/blackbox), setpoint to
body rate, at 50 Hz. Every flight is judged by models that were fitted to the others, in five folds; of every
pair of models, the standard deviation over flights of log(RMSE_b / RMSE_a), beside its mean.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.model.arx import ARX
from flysid.model.base import Estimator
from flysid.model.oe import OE
from flysid.model.ts import TS
from flysid.split import plan_folds
from flysid.validate.compare.intervals import flight_logs
from flysid.validate.compare.trials import FREE_RUN, run_trials

LOGS = Path(__file__).resolve().parents[2] / "shared" / "logs" / "blackbox"
CHANNELS = ("roll_rate", "pitch_rate", "yaw_rate")
MODELS: Mapping[str, Estimator] = {
    "arx of order 1": ARX(na=1, nb=1, nk=1),
    "arx of order 3": ARX(na=3, nb=3, nk=1),
    "oe of order 2": OE(na=2, nb=2, nk=1),
    "ts of 2 rules": TS(rules=2, na=2, nb=2, nk=1),
}


def errors(data: Dataset) -> tuple[dict[str, list[FloatArray]], list[str]]:
    """Free-run errors of every model on flights that it has not seen, and the flight of each."""
    found: dict[str, list[FloatArray]] = {name: [] for name in MODELS}
    flights: list[str] = []
    for split in plan_folds(data, 5):
        train, test = split.apply(data)
        models = {name: estimator.fit(train) for name, estimator in MODELS.items()}
        for trial in run_trials(models, test, FREE_RUN):
            flights.append(test.segments[trial.segment].flight)
            for name, own in found.items():
                own.append(trial.y[:, 0] - trial.yh[name][:, 0])
    return found, flights


def lines(data: Dataset) -> Iterator[str]:
    """One per pair of models."""
    found, flights = errors(data)
    for a, b in combinations(MODELS, 2):
        logs = np.array(list(flight_logs(found[a], found[b], flights).values()))
        yield (
            f"{data.name}, {b} against {a}: spread {logs.std(ddof=1):.3f} over {len(logs)} flights, mean "
            f"{logs.mean():+.3f}, lower on {int((logs < 0.0).sum())}"
        )


def real_flights(rate_hz: float) -> Iterator[Dataset]:
    """Setpoint to body rate of every axis, over all flights."""
    with tempfile.TemporaryDirectory() as folder:
        logs = find_logs([LOGS / "greenreaper_flight*.bfl"])
        list(ingest_logs(logs, Path(folder) / "data"))
        recipe = replace(load_recipe("betaflight-rate"), max_rate_hz=rate_hz)
        lake = open_lake(Path(folder) / "data")
        for channel in CHANNELS:
            yield lake.dataset(recipe, channel)


def main() -> None:
    """Print the lines of every channel."""
    for data in real_flights(float(sys.argv[1]) if len(sys.argv) > 1 else 50.0):
        for line in lines(data):
            print(line, flush=True)


if __name__ == "__main__":
    main()
