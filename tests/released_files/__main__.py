"""Writes the files of the present version; refuses where they are there."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np

from flysid.datasetfile import write_dataset
from flysid.files import slug
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.synth.synth import WRITERS, Order, flights
from flysid.validate.runs.fitting import fit_run
from flysid.validate.runs.judge import judge_run
from flysid.validate.runs.run import FitSettings
from flysid.validate.show.finish import finish, write_finished
from flysid.version import __version__
from tests.model_examples import EXAMPLES, data
from tests.released_files import FOLDER

SAMPLES = 60


def write(folder: Path) -> None:
    """All files into a new folder."""
    (folder / "models").mkdir(parents=True)
    expected = {}
    for name, (build, dataset) in EXAMPLES.items():
        model = build(dataset)
        file = f"{slug(name)}.json"
        model.save(folder / "models" / file)
        u = dataset.segments[0].u[:SAMPLES]
        y = dataset.segments[0].y[:SAMPLES]
        expected[file] = {
            "u": u.tolist(),
            "y": y.tolist(),
            "free_run": model.simulate(u, y[: model.n_init]).tolist(),
            "one_step": np.nan_to_num(model.predict(u, y)).tolist(),
        }
    (folder / "expected.json").write_text(json.dumps(expected) + "\n")
    write_dataset(folder / "dataset.parquet", data(2, 1, samples=50))
    _write_run(folder)


def _write_run(folder: Path) -> None:
    logs = folder / "logs"
    logs.mkdir()
    suffix, encode = WRITERS["tlog"]
    for recording in flights(Order(duration_s=12.0)):
        (logs / f"{recording.name}{suffix}").write_bytes(encode(recording))
    kept = sorted(logs.iterdir())[:2]
    list(ingest_logs(find_logs(kept), folder / "data", bounds=None))
    settings = FitSettings(channels=("vertical",), rules=1, by="time")
    run = fit_run(open_lake(folder / "data"), "ardrone-synthetic", folder / "run", settings)
    write_finished(finish(judge_run(run), page=True), folder / "run" / "report")
    (folder / "run" / "report" / "report.html").unlink()
    document = json.loads((folder / "run" / "run.json").read_text())
    text = json.dumps(document | {"data": "data"}, indent=1) + "\n"  # no path of this machine
    (folder / "run" / "run.json").write_text(text)
    shutil.rmtree(logs)
    (folder / "data" / ".lock").unlink(missing_ok=True)


def main() -> int:
    folder = FOLDER / f"v{__version__}"
    if folder.exists():
        sys.stderr.write(f"{folder} is there: what was released is not changed\n")
        return 1
    write(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
