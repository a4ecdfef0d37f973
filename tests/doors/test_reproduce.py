"""`flysid reproduce ardrone-ts`, whole: 400 s, every rival of the linear side, all three loops.

tests/validate/paper/test_reproduction.py asks more of a quarter of the record.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

from tests.doors import tally
from tests.doors.reader import Reader

STATIC_M_S = {"longitudinal": 0.0256, "lateral": 0.1225, "vertical": 0.0690}
DYNAMIC_M_S = {"longitudinal": 1e-4, "lateral": 1e-3, "vertical": 1e-4}


def test_the_paper_is_reproduced(tmp_path: Path, record_property: Callable[[str, object], None]) -> None:
    reader = Reader(tmp_path / "here")
    reader.folder.mkdir()
    done = reader.run("python -m tests.doors.reproduce_forms")
    record_property(tally.PROPERTY, reader.cpu_s)
    assert done.returncode == 0, done.stderr
    loops = json.loads((reader.folder / "json.txt").read_text("utf-8"))["loops"]
    assert set(loops) == set(STATIC_M_S)
    for name, found in loops.items():
        assert max(found["static_ts_7"]["rmse"], found["static_ts_3"]["rmse"]) <= STATIC_M_S[name], name
        assert found["dynamic_ts_3"]["rmse"] <= DYNAMIC_M_S[name], name
        assert found["verdict"] in ("same", "worse"), name
    text = (reader.folder / "text.txt").read_text("utf-8")
    assert (reader.folder / "figures.txt").read_text("utf-8") == text
    assert "What cannot be reproduced, and why" in text
    told = re.findall(r"static TS, 7 rules +(\S+)|dynamic TS, 3 rules, free run +(\S+)", text)
    figures = [
        (f"{loops[n]['static_ts_7']['rmse']:.3g}", f"{loops[n]['dynamic_ts_3']['rmse']:.3g}") for n in loops
    ]
    assert [a or b for a, b in told] == [figure for pair in figures for figure in pair]
    drawn = sorted((reader.folder / "figures").iterdir())
    assert [file.name for file in drawn] == [
        "figure-4-longitudinal.pdf",
        "figure-5-lateral.pdf",
        "figure-6-vertical.pdf",
    ]
    assert all(file.read_bytes().startswith(b"%PDF") for file in drawn)
