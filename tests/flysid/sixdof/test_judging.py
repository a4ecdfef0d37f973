"""Left-out flights judge: physics leads early, no predictor sees what it may not, words follow the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import flysid
from flysid.cli import root
from flysid.dataset import Dataset
from flysid.sixdof.far import fit_far, habits, with_commands
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.horizons import KINDS
from flysid.sixdof.judging import (
    ALONE,
    AXES,
    BLIND,
    BOX,
    HELD,
    HORIZONS_S,
    LOOP,
    Judgement,
    _starts,
    errors_at_end,
    judge_vehicle,
)
from flysid.sixdof.records import Scale
from tests.flysid.sixdof.hidden_quad import write_table


@pytest.fixture(scope="module")
def judged(gusty: Dataset, gusty_regressed: FittedVehicle) -> Judgement:
    found = judge_vehicle(flysid.Vehicle(free_runs=False), gusty, gusty_regressed)
    assert found is not None
    return found


def test_physics_leads_early_and_the_loop_later(judged: Judgement) -> None:
    assert judged.tested == "1 flight left out (flight-1)"
    assert all(judged.starts)
    early = {name: (rows[0] / judged.table[HELD][0]).mean() for name, rows in judged.table.items()}
    assert early[ALONE] < min(early[name] for name in (HELD, BLIND, AXES, BOX))
    assert early[LOOP] < early[BLIND]
    assert judged.table[LOOP][2].sum() < judged.table[ALONE][2].sum()
    assert "physics alone predicts best up to" in judged.words()[0]


def test_no_inputs_means_none(gusty: Dataset) -> None:
    starts = _starts(gusty, Scale(0.0, 1.0))[1]
    assert not np.allclose(with_commands(starts[0])[:, : habits(starts[0]).shape[1] + 4].std(axis=0), 0.0)
    blind = fit_far(starts, habits)
    rows = errors_at_end(starts[0], blind.predict(starts[0]))
    assert rows.shape == (len(KINDS),)
    assert habits(starts[0]).shape[1] < with_commands(starts[0]).shape[1]


@pytest.mark.parametrize(
    ("sizes", "words"),
    [
        ([0.5, 0.5, 0.5, 0.5], "physics alone is enough"),
        ([0.5, 0.5, 2.0, 9.0], "up to 0.5 s. At 1 s the black box is better"),
        ([2.0, 2.0, 2.0, 2.0], "not the best at 0.1 s: the black box predicts better"),
    ],
)
def test_words_follow_the_table(sizes: list[float], words: str) -> None:
    one = np.ones((len(HORIZONS_S), len(KINDS)))
    table = {HELD: 3.0 * one, BLIND: 1.5 * one, AXES: 1.2 * one, BOX: one, LOOP: 0.9 * one}
    table[ALONE] = np.array(sizes)[:, None] * one
    assert words in Judgement(table, (1, 1, 1, 1), "1 flight").words()[0]


def test_the_verb_prints_it_and_without_positions_does_not(short: Dataset, tmp_path: Path) -> None:
    table = write_table(tmp_path / "flight.csv", short)
    done = CliRunner().invoke(root, ["vehicle", str(table), "--calm", "-q"], catch_exceptions=False)
    assert done.exit_code == 0
    assert "judged on the last third of" in done.stdout
    assert "no inputs" in done.stdout
    assert "no rule on what physics leaves" in done.stdout
    lines = [line.split(",") for line in table.read_text("utf-8").splitlines()]
    kept = [i for i, name in enumerate(lines[0]) if not name.startswith("p_")]
    table.write_text("\n".join(",".join(line[i] for i in kept) for line in lines), "utf-8")
    done = CliRunner().invoke(root, ["vehicle", str(table), "--calm", "-q"], catch_exceptions=False)
    assert "judged on" not in done.stdout
