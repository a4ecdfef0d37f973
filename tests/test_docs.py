"""The examples in the documentation run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from flysid.ingest.batch import find_logs, ingest_logs

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def test_the_examples_of_models_md_run_one_after_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert not any(
        r.skipped for r in ingest_logs(find_logs([ROOT / "sample_logs"]), tmp_path / "data", jobs=1)
    )
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in BLOCK.findall((ROOT / "docs" / "models.md").read_text("utf-8")):
        exec(block, names)
    told = capsys.readouterr().out
    assert "R1 spoke with" in told
    assert "no difference shown" in told  # the sample logs are of a linear plant
    assert (tmp_path / "ts.json").is_file()
