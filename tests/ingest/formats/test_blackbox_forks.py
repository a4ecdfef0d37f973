"""INAV, EmuFlight, Rotorflight: every field of their tables, as written and as another decoder reads it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import flysid
from tests.blackbox_trials import FIRMWARES, draw, trials
from tests.table_trials import always

DECODER = os.environ.get("ORANGEBOX_PYTHON", sys.executable)
DECODE = """
import json, sys
from orangebox import Parser
parser = Parser.load(sys.argv[1])
print(json.dumps([parser.field_names, [list(frame.data) for frame in parser.frames()]]))
"""


def test_every_number_comes_back() -> None:
    """A failure names its seed: `tests.blackbox_trials.draw(seed)` draws it again. Row 41 draws others."""
    outcome = trials(6, always)
    assert outcome.failures == [], outcome.failures
    assert outcome.trials == 6


def test_a_frame_may_take_more_than_256_bytes() -> None:
    """INAV logs up to 131 fields; nine of ten rows were lost as damage."""
    trial = draw(0)
    assert trial.revision.startswith("INAV")
    assert len(trial.names["main"]) == 131
    frames = len(trial.rows["main"])
    assert len(trial.blob) / frames > 150  # on average, most of them P frames


@pytest.mark.parametrize("seed", range(len(FIRMWARES)))
def test_another_decoder_reads_the_same(seed: int, tmp_path: Path) -> None:
    """Orangebox, where it is installed or ORANGEBOX_PYTHON names a Python that has it."""
    trial = draw(seed)
    log = tmp_path / "log.bbl"
    log.write_bytes(trial.blob)
    done = subprocess.run([DECODER, "-c", DECODE, log], capture_output=True, text=True)
    if "No module named 'orangebox'" in done.stderr:
        pytest.skip("needs orangebox")
    assert done.returncode == 0, done.stderr
    names, frames = json.loads(done.stdout)
    main = flysid.read(log)["main"]
    for name in trial.names["main"]:
        theirs = [frame[names.index(name)] for frame in frames]
        assert [int(value) for value in main[name].to_pylist()] == theirs, name
