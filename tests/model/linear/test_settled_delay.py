"""Three lags behind a dead time: neither the delay nor the order hangs on which samples were recorded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench import drawn_plants
from bench.lottery import CHANGES
from bench.ts_experiment import off
from flysid.cli import root
from flysid.dataset import Dataset
from flysid.filters import apply_filter
from flysid.model.arx import ARX
from flysid.model.base import load
from flysid.model.oe import OE
from flysid.model.simulation_error import OutputError, Start, find_start
from flysid.model.start import full_window, judging_rows

DT_S = drawn_plants.DT_S


@pytest.mark.parametrize("change", ["first 7 dropped", "first 20 dropped", "98 %"])
@pytest.mark.parametrize(("number", "most"), [(40_004, 0.12), (40_044, 0.2)])
def test_free_run_is_right_whatever_was_dropped(number: int, most: float, change: str) -> None:
    """A model of two lags takes the third for dead time: its delay erred by 0.32 and 0.22 to 0.75 %."""
    flown = drawn_plants.drawn(number)
    assert off(ARX().fit(CHANGES[change](flown.train)), flown.test) < most


def test_command_delivers_it(tmp_path: Path) -> None:
    """One flight; a part of it is held out for the comparison."""
    flown = drawn_plants.drawn(40_044)
    segment = flown.train.segments[0]
    columns = np.column_stack([DT_S * np.arange(len(segment)), segment.u, segment.y])
    table = tmp_path / "flight.csv"
    np.savetxt(table, columns, delimiter=",", header="time_s,u,y", comments="", fmt="%.9g")
    run = tmp_path / "run"
    words = ["fit", str(table), "--from", "u", "--to", "y", "--models", "arx", "-o", str(run), "--quiet"]
    done = CliRunner().invoke(root, words)
    assert done.exit_code == 0, done.output
    (path,) = run.rglob("arx.json")
    assert off(load(path), flown.test) < 0.5


def test_outputs_whose_delays_stay_are_fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second output's delay is looked for again, for order three; the first one's fits are known."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1.0, 1.0, 60), 10)
    quick = apply_filter(np.array([0.0, 0.2]), np.array([1.0, -0.8]), u)
    slow = apply_filter(np.array([0.0, 0.0, 0.02]), np.asarray(np.poly([0.9, 0.8, 0.7])), u)
    y = np.column_stack([quick, slow])
    y += 0.01 * y.std(axis=0) * rng.standard_normal(y.shape)
    asked = []

    def note(problem: OutputError, *, tries: int = 2, polish: int = 3) -> Start:
        asked.append((problem.key, tries, polish))
        return find_start(problem, tries=tries, polish=polish)

    monkeypatch.setattr("flysid.model.linear.output_error.find_start", note)
    OE().fit(Dataset.from_arrays(u, y, DT_S))
    assert len(asked) == len(set(asked))


def test_short_blocks_are_started_from_as_much_as_they_are_judged_on() -> None:
    assert judging_rows(3, 53, DT_S) == full_window(3, DT_S) == 20
    assert judging_rows(14, 53, DT_S) == 53 // 2
    assert judging_rows(30, 53, DT_S) == 30
