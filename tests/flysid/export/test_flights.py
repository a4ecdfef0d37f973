"""The page on model predictive control as printed, and its run's models on the flights they have not seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flysid.model.start import estimate_start, start_window
from flysid.validate.runs.run import held_out, open_run
from tests.command import ROOT, call
from tests.doors.pages import check_answer, lines_of, scripts_of
from tests.flysid.export.callers import SCRIPT, require, run_python

PAGE = "docs/mpc.md"
ROWS = 500
HORIZON = 50


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the page's lines of flysid leave in a folder."""
    folder = tmp_path_factory.mktemp("mpc")
    (folder / "sample_logs").symlink_to(ROOT / "sample_logs")
    for line in lines_of(PAGE):
        words = line.command.split()
        if words[0] == "flysid":
            done = call(*words[1:], cwd=folder)
            assert done.returncode == 0, done.stderr
    return folder


def test_the_controller_of_the_page_tracks_its_step(place: Path) -> None:
    python = require("casadi")
    (script,) = scripts_of(PAGE)
    (place / "mpc.py").write_text(script, "utf-8")
    (line,) = [line for line in lines_of(PAGE) if line.command == "python mpc.py"]
    check_answer(line, run_python(python, "mpc.py", cwd=place).splitlines())


@pytest.mark.parametrize("dialect", ["casadi", "jax"])
def test_free_runs_of_held_out_flights_equal_the_models_to_1e_9(dialect: str, place: Path) -> None:
    python = require(dialect, "numpy")
    data = held_out(open_run(place / "run"))[0]
    segment = max(data.test.segments, key=len)
    u = segment.u[: 2 * ROWS]
    expected = {}
    for label, model in data.models.items():
        window = start_window(model.n_init, ROWS, model.dt_s)
        known = estimate_start(model, u[:window], segment.y[:window])[: max(model.n_init, 1)]
        words = ("export", "run", "--model", label, f"--{dialect}", f"{dialect}/{label}_{dialect}.py")
        (place / dialect).mkdir(exist_ok=True)
        assert call(*words, cwd=place).returncode == 0
        weights = np.ones((HORIZON, len(model.outputs)))
        np.savez(place / dialect / label, u=u.reshape(2, ROWS, -1), weights=weights, measured=known)
        expected[label] = model.simulate(u[:ROWS], known)[len(known) :]
    run_python(python, SCRIPT, dialect, place / dialect, cwd=place)
    assert {"arx", "oe", "ts"} <= set(expected)
    for label, free in expected.items():
        found = np.load(place / dialect / f"{label}.{dialect}.npz")
        assert np.ptp(free) > 0.1 or label in ("mean", "persistence")
        np.testing.assert_allclose(found["go_on"], free, rtol=0.0, atol=1e-9)
