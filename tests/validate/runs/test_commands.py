"""The command line that fits a run again, for every setting that has an option."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest

from flysid.ingest.lake.chosen_flights import Selection
from flysid.validate.runs.provenance import fit_command
from flysid.validate.runs.run import FitSettings, Run

PLAIN = "flysid fit DATA --recipe r --holdout 0.3 --by auto --seed 7 --rules auto"


def command(settings: FitSettings, recipe: str = "r") -> str:
    return fit_command(cast(Run, SimpleNamespace(recipe=recipe, settings=settings)))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (FitSettings(), PLAIN),
        (
            FitSettings(holdout=0.25, by="time", seed=8, rules=3),
            "flysid fit DATA --recipe r --holdout 0.25 --by time --seed 8 --rules 3",
        ),
        (FitSettings(held=("a", "b:2")), PLAIN.replace("--holdout 0.3", "--holdout a --holdout b:2")),
        (FitSettings(antecedents=("x", "y z")), PLAIN + " --antecedent x --antecedent 'y z'"),
        (FitSettings(channels=("roll",)), PLAIN + " --channel roll"),
        (FitSettings(selection=Selection(flights=("f",))), PLAIN + " --flight f"),
        (FitSettings(models=("oe", "ts")), PLAIN + " --models oe,ts"),
        (FitSettings(effort="quick"), PLAIN + " --effort quick"),
        (FitSettings(flight_offsets="no"), PLAIN + " --flight-offsets no"),
        (FitSettings(rotate=False), PLAIN + " --no-rotate"),
        (FitSettings(memory_mb=32.0), PLAIN + " --memory 32"),
    ],
)
def test_a_run_names_the_command_that_fits_it_again(settings: FitSettings, words: str) -> None:
    assert command(settings) == words


def test_a_run_without_a_recipe_names_none() -> None:
    assert command(FitSettings(), recipe="") == PLAIN.replace(" --recipe r", "")
