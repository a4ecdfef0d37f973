"""Logs that are made to break their readers, dropped on the page: each is answered, and so is all else."""

from __future__ import annotations

import random
import shutil
from pathlib import Path
from urllib.parse import quote

from tests.flysid.studio.server import studio
from tests.hostile_files import contents, suffix_of
from tests.ingest.lake.sound_logs import sound_table

KINDS = ("zip, name empty name", "parquet, a column twice", "parquet, nested", "db3, odd schema")


def test_every_hostile_log_is_answered_and_the_flights_are_listed(data: Path, tmp_path: Path) -> None:
    logs = {
        f"hostile{k}{suffix_of(kind)}": contents()[kind](random.Random(k)) for k, kind in enumerate(KINDS)
    }
    logs["sound.csv"] = sound_table(3)
    with studio(Path(shutil.copytree(data, tmp_path / "data"))) as running:
        before = {flight["id"] for flight in running.get("flights").json["flights"]}
        jobs = []
        for name, blob in logs.items():
            answer = running.send("POST", f"uploads?name={quote(name)}", blob)
            assert answer.status == 202, (name, answer.body)
            look = running.get(f"uploads/{answer.json['upload']}")
            assert look.status == 200, (name, look.body)
            jobs.append(answer.json["job"]["id"])
        ended = [running.wait(job)["state"] for job in jobs]
        assert ended[-1] == "done"
        listed = running.get("flights")
        assert listed.status == 200
        after = {flight["id"] for flight in listed.json["flights"]}
    assert before < after
    assert any(name.startswith("sound-") for name in after - before)
