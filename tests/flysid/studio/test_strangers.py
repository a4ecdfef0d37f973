"""Runs, jobs and folders beside the data may be a stranger's: nothing that they name is served or run."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from flysid.errors import StoreError
from flysid.studio.folders import open_workspace, short_id
from flysid.studio.jobs import Job, Jobs
from tests.flysid.studio.server import studio
from tests.released_files import released

SECRET = "root:x:0:0"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    for name in ("run", "data"):
        shutil.copytree(released()[-1] / name, tmp_path / "strangers" / name)
    (tmp_path / "secret").write_text(SECRET)
    return tmp_path / "strangers"


def test_no_address_serves_a_file_that_a_run_names(place: Path) -> None:
    run = place / "run"
    body = json.loads((run / "run.json").read_text())
    [channel] = body["channels"]
    channel["models"] = {"arx": "../../secret", "line": str(place.parent / "secret"), "ts": "link.json"}
    (run / "run.json").write_text(json.dumps(body))
    (run / "link.json").symlink_to("../../secret")
    (run / "report" / "report.html").symlink_to("../../../secret")
    (run / "report" / "figure.pdf").symlink_to("/etc/passwd")
    (run / "recipe.toml").unlink()
    (run / "recipe.toml").symlink_to("../../secret")
    with studio(place / "data") as server:
        name = short_id(run)
        addresses = [f"runs/{name}/models/{channel['name']}/{label}" for label in channel["models"]]
        addresses += [f"runs/{name}/report.html", f"runs/{name}/files/figure.pdf", f"runs/{name}"]
        for address in addresses:
            answer = server.get(address)
            assert SECRET not in answer.body.decode(), address
            assert answer.status != 500
        assert server.get(addresses[0]).status == 400
        assert "run.json" in server.get(addresses[0]).json["where"]


def queued(folder: Path, job: Job) -> None:
    place = folder / job.id.replace("/", "_")
    place.mkdir(parents=True)
    (place / "job.json").write_text(json.dumps({**job_as_dict(job), "state": "queued"}))


def job_as_dict(job: Job) -> dict[str, Any]:
    return {name: getattr(job, name) for name in job.__struct_fields__}


def test_jobs_that_lie_beside_the_data_are_not_run(place: Path) -> None:
    jobs = place / "data.studio" / "jobs"
    canary = place / "ran"
    words = ("synth", "-o", str(canary), "--duration", "5")
    for k, seal in enumerate(("", "0" * 64)):
        queued(jobs, Job(f"{k}", words, "read", then=words, seal=seal))
        queued(jobs, Job(f"{k}-fit", words, "fit", then=words, seal=seal))
    queued(jobs, Job("../../outside", words, "read"))
    with studio(place / "data") as server:
        time.sleep(1.0)
        listed = server.get("jobs").json["jobs"]
        assert {job["state"] for job in listed} == {"interrupted"}
        assert len(listed) == 4
    assert not canary.exists()
    assert not (place / "outside").exists()


def test_a_seal_is_of_one_folder_and_one_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    own = tmp_path / "own"
    own.mkdir()
    job = Jobs(own).add(("ls", "data"), "read", {})
    assert Jobs(own).get(job.id).state == "queued"
    key = tmp_path / "state" / "flysid" / "studio.key"
    assert key.stat().st_mode & 0o077 == 0
    shutil.copytree(own, tmp_path / "other")
    assert Jobs(tmp_path / "other").get(job.id).state == "interrupted"
    path = own / job.id / "job.json"
    path.write_text(path.read_text().replace('"data"', '"elsewhere"'))
    assert Jobs(own).get(job.id).state == "interrupted"
    key.write_bytes(b"")
    assert Jobs(own).add(("ls", "data"), "read", {}).state == "queued"


def test_what_a_job_has_printed_is_no_link(place: Path) -> None:
    jobs = place / "data.studio" / "jobs"
    queued(jobs, Job("1", ("ls",), "read"))
    for name in ("out", "log"):
        (jobs / "1" / name).symlink_to("../../../../secret")
    with studio(place / "data") as own:
        answer = own.get("jobs/1")
        assert answer.status == 400
        assert SECRET not in answer.body.decode()


@pytest.mark.parametrize("name", ["uploads", "jobs", "runs", "recipes"])
def test_folders_of_the_studio_are_no_links(place: Path, name: str) -> None:
    (place / "data.studio").mkdir()
    (place / "data.studio" / name).symlink_to("../..")
    with pytest.raises(StoreError, match="is a link that leads out"):
        open_workspace(place / "data")


def test_what_killed_processes_left_is_removed_and_what_others_are_at_stays(place: Path) -> None:
    with subprocess.Popen(["true"]) as process:
        process.wait()
    ended, running = process.pid, os.getpid()
    flights = place / "data" / "flights"
    own = place / "data.studio"
    own.mkdir()
    for pid in (ended, running):
        (flights / f".incoming-log-01-{pid}").mkdir()
        (place / "data" / f".flysid-data.json.{pid}").touch()
        (place / "data" / f"..catalogue.{pid}").touch()
        (own / f".views-{pid}-abcd1234").mkdir()
    (own / f".views-{ended}-link0000").symlink_to(place / "run")
    open_workspace(place / "data")
    left = [path for folder in (flights, place / "data", own) for path in folder.iterdir()]
    names = [path.name for path in left]
    assert not [name for name in names if str(ended) in name]
    assert len([name for name in names if str(running) in name]) == 4
    assert (place / "run" / "run.json").is_file()
    assert len([path for path in flights.iterdir() if not path.name.startswith(".")]) == 2


def test_a_studio_that_was_killed_leaves_nothing_for_long(place: Path) -> None:
    with studio(place / "data") as server:
        server.process.kill()
        server.process.wait()
    assert list((place / "data.studio").glob(".views-*"))
    with studio(place / "data") as server:
        [mine] = (place / "data.studio").glob(".views-*")
        assert str(server.process.pid) in mine.name
    assert not list((place / "data.studio").glob(".views-*"))
