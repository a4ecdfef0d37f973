"""A structured model in a run: named with its file, judged in free run beside the others."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from flysid.cli import root
from flysid.datasetfile import write_dataset
from flysid.errors import UsageError
from flysid.validate.runs.run import FitSettings, open_run
from flysid.validate.runs.wanted_models import estimators
from tests.model.test_structured import SHORT_PERIOD, flights


@pytest.mark.usefixtures("arx_alone")
def test_a_run_holds_the_model_of_a_file_and_judges_it(tmp_path: Path) -> None:
    file = tmp_path / "Short Period.toml"
    file.write_text(SHORT_PERIOD)
    write_dataset(tmp_path / "data.parquet", flights(2))
    words = ["fit", str(tmp_path / "data.parquet"), "-m", f"line, Structured:{file}", "-o"]
    done = CliRunner().invoke(root, [*words, str(tmp_path / "run")], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    (channel,) = open_run(tmp_path / "run").channels
    assert channel.models["structured"]
    assert (tmp_path / "run" / "structured.toml").read_text() == SHORT_PERIOD
    judged = CliRunner().invoke(root, ["validate", str(tmp_path / "run")], catch_exceptions=False)
    assert judged.exit_code == 0, judged.output
    assert "structured" in judged.output
    assert "Z_w = " in next((tmp_path / "run").rglob("structured.txt")).read_text()


@pytest.mark.parametrize(
    ("models", "words"),
    [
        (("arx:x.toml",), "arx takes no file"),
        (("structured:a.toml", "structured:b.toml"), "a run takes one structured model"),
        (("structure",), "no model 'structure'"),
    ],
)
def test_models_that_cannot_be_are_refused(models: tuple[str, ...], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        estimators(FitSettings(models=models))
