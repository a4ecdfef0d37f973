"""Jobs outlive the server that began them; cancel leaves no process; a run is the command line's."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flysid.studio.jobs import group_exists
from flysid.studio.warm import Warm
from tests.flysid.studio.server import FIT, SAMPLES, Server, studio
from tests.flysid.studio.test_flights import decoded


@pytest.fixture
def own(data: Path, tmp_path: Path) -> Path:
    """A copy of the flights for a studio that writes."""
    return Path(shutil.copytree(data, tmp_path / "data"))


def started(server: Server, fit: dict[str, Any]) -> Any:
    """A fit whose process runs."""
    job = server.send("POST", "fits", fit).json
    until = time.monotonic() + 60
    while server.get(f"jobs/{job['id']}").json["state"] == "queued":
        assert time.monotonic() < until
        time.sleep(0.05)
    return server.get(f"jobs/{job['id']}").json


def test_the_page_shows_the_command_before_it_runs(server: Server) -> None:
    before = {job["id"] for job in server.get("jobs").json["jobs"]}
    told = server.send(
        "POST", "fits", FIT | {"preview": True, "flights": ["x y"], "between": "0:01..0:02"}
    ).json
    assert told["command"].startswith(
        f"flysid fit {server.data} --recipe ardrone-synthetic --channel vertical"
    )
    assert (
        "--flight 'x y' --between 0:01..0:02 --models line,ts --rules 2 --effort quick -o" in told["command"]
    )
    assert told["then"].startswith("flysid validate ")
    assert {job["id"] for job in server.get("jobs").json["jobs"]} == before


def test_what_cannot_be_fitted_is_told_at_once(server: Server) -> None:
    assert server.send("POST", "fits", {"preview": True}).status == 400
    assert server.send("POST", "fits", FIT | {"recipe": "nothing"}).status == 404
    assert server.send("POST", "validates", {"run": "nothing"}).status == 404


def test_cancel_leaves_no_process(own: Path) -> None:
    with studio(own) as server:
        job = started(server, FIT)
        queued = server.send("POST", "fits", FIT).json
        assert server.send("DELETE", f"jobs/{job['id']}").json["state"] == "cancelled"
        assert not group_exists(job["pid"])
        assert server.send("DELETE", f"jobs/{queued['id']}").json["state"] == "cancelled"
        assert server.get("runs").json["runs"] == []


def test_a_server_that_is_killed_leaves_its_jobs_to_the_next(own: Path) -> None:
    """What ran goes on, what waited begins, and a job whose process was killed is said to be interrupted."""
    with studio(own) as first:
        running = started(first, FIT)
        waiting = first.send("POST", "fits", FIT).json
        os.killpg(running["pid"], signal.SIGSTOP)  # else it might be through before the second has begun
        first.process.kill()
        first.process.wait()
    assert group_exists(running["pid"])
    with studio(own) as second:
        states = {job["id"]: job["state"] for job in second.get("jobs").json["jobs"]}
        assert states[running["id"]] == "running"
        assert states[waiting["id"]] == "queued"
        os.killpg(running["pid"], signal.SIGKILL)
        assert second.wait(running["id"])["state"] == "interrupted"
        until = time.monotonic() + 60
        while second.get(f"jobs/{waiting['id']}").json["state"] == "queued":
            assert time.monotonic() < until
            time.sleep(0.05)
        assert second.send("DELETE", f"jobs/{waiting['id']}").json["state"] == "cancelled"


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere each job begins from nothing")
def test_a_job_that_reads_is_forked_from_a_process_that_has_all(tmp_path: Path) -> None:
    """It writes what the command writes, in a group of its own; what forks it may end before it does."""
    warm = Warm()
    folder = reading(tmp_path, "01-multisine-seed1.tlog")
    until = time.monotonic() + 120
    while not (pid := warm.begin(folder)):  # it is still importing
        assert time.monotonic() < until
        time.sleep(0.05)
    os.killpg(pid, signal.SIGSTOP)
    warm.close()
    assert group_exists(pid)
    os.killpg(pid, signal.SIGCONT)
    while not (folder / "ended.json").is_file():
        assert time.monotonic() < until
        time.sleep(0.05)
    assert json.loads((folder / "ended.json").read_text()) == {"code": 0}
    assert (folder / "out").read_text().startswith("01-multisine-seed1-")
    assert "reading" in (folder / "log").read_text()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere each job begins from nothing")
def test_a_job_begins_where_there_is_nothing_to_fork_it(tmp_path: Path) -> None:
    warm = Warm()
    os.killpg(warm.pid, signal.SIGKILL)
    assert warm.begin(reading(tmp_path, "01-multisine-seed1.tlog")) == 0
    warm.close()


def reading(place: Path, name: str) -> Path:
    """The folder of a job that reads a sample log."""
    folder = place / "job"
    folder.mkdir()
    words = ["ingest", str(SAMPLES / name), "-o", str(place / "data"), "--jobs", "1"]
    (folder / "job.json").write_text(json.dumps({"words": words}), "utf-8")
    return folder


def test_a_run_is_listed_with_its_verdict_its_page_and_its_models(judged: Server) -> None:
    [run] = judged.get("runs").json["runs"]
    assert run["judged"]
    assert run["name"] == "mine"
    assert run["channels"][0]["scope"]
    page = judged.get(f"runs/{run['id']}/report.html")
    assert page.headers["content-security-policy"].startswith("sandbox allow-scripts;")
    assert judged.get(f"runs/{run['id']}/models/vertical/arx").json["structure"] == "arx"
    assert judged.get(f"runs/{run['id']}/models/vertical/nothing").status == 404
    assert judged.get(f"runs/{run['id']}").json["report"]["channels"]


def test_the_events_of_a_job_tell_its_progress_and_resume(judged: Server) -> None:
    job = judged.get("jobs").json["jobs"][-1]
    path = f"/api/1/jobs/{job['id']}/events"
    events = judged.raw("GET", path, headers={"Cookie": judged.cookie}).body.decode()
    lines = [
        json.loads(line.removeprefix("data: ")) for line in events.splitlines() if line.startswith("data:")
    ]
    steps = [json.loads(line) for line in lines if isinstance(line, str) and line.startswith("{")]
    assert {step["channel"] for step in steps} >= {"vertical"}
    assert steps[-1]["share"] > 0.9
    assert any("validation" in step for step in steps)
    assert events.rstrip().rpartition("event: ")[2].startswith("ended")
    resumed = judged.raw("GET", path, headers={"Cookie": judged.cookie, "Last-Event-ID": "2"}).body.decode()
    assert "\nid: 3\n" in resumed
    assert "\nid: 2\n" not in resumed


def test_a_second_is_explained_in_words(judged: Server) -> None:
    [run] = judged.get("runs").json["runs"]
    asked = {"ch": "vertical", "segment": 0}
    told = judged.get(f"runs/{run['id']}/explanation", asked).json
    assert len(told["y"]) == len(told["u"])
    assert all(len(m["yh"]) == len(told["y"]) - told["first"] for m in told["models"].values())
    words = judged.get(f"runs/{run['id']}/explanation", asked | {"row": 60}).json["words"]
    assert all("together" in text for text in words.values())
    for wrong in ({"ch": "nothing"}, asked | {"segment": 99}, asked | {"row": 10**9}, asked | {"row": "x"}):
        assert judged.get(f"runs/{run['id']}/explanation", wrong).status in (400, 404)


def test_a_run_links_its_worst_second_and_gives_its_files(judged: Server) -> None:
    [run] = judged.get("runs").json["runs"]
    [worst] = judged.get(f"runs/{run['id']}/worst").json.values()
    told = judged.get(f"runs/{run['id']}/explanation", {"ch": "vertical", "segment": worst["segment"]}).json
    errors = [
        (yh[0] - told["y"][told["first"] + k][0]) ** 2
        for k, yh in enumerate(told["models"][worst["model"]]["yh"])
    ]
    width = round(1.0 / told["dt_s"])
    sums = [sum(errors[k : k + width]) for k in range(len(errors) - width + 1)]
    assert worst["row"] == told["first"] + sums.index(max(sums)) + width // 2
    assert worst["seen"]["flight"] == worst["seen"]["flight"].partition("#")[0]
    signals = [f"@run/{run['id']}:{name}" for name in ("vz_in", "v_z")]
    assert worst["seen"]["signals"] == signals
    flight = judged.get("flights/" + worst["seen"]["flight"]).json
    assert 0.0 <= worst["seen"]["begin_s"] + worst["second_s"] <= flight["duration_s"]
    for name in run["files"]:
        kept = judged.get(f"runs/{run['id']}/files/{name}")
        assert kept.headers["content-disposition"].startswith("attachment")
    for name in ("..%2Frun.json", "run.json", "%2e%2e"):
        assert judged.get(f"runs/{run['id']}/files/{name}").status == 404


def test_the_signals_of_a_run_are_those_of_its_own_recipe(judged: Server) -> None:
    """Not of the shipped one that has the same name."""
    [run] = judged.get("runs").json["runs"]
    runs = judged.data.with_name(f"{judged.data.name}.studio") / "runs"
    own = Path(shutil.copytree(run["folder"], runs / "own"))
    try:
        shipped = (own / "recipe.toml").read_text("utf-8")
        changed = shipped.replace('"vz_in", unit = "m/s" }', '"vz_in", unit = "m/s", scale = 2.0 }')
        changed = changed.replace('"vz", unit = "m/s", scale = -1.0', '"vz", unit = "m/s", scale = -2.0')
        (own / "recipe.toml").write_text(changed, "utf-8")
        [copy] = [r["id"] for r in judged.get("runs").json["runs"] if r["name"] == "own"]
        flight = judged.get("flights").json["flights"][0]["id"]
        asked = {
            "f": flight,
            "s": ["@ardrone-synthetic:vz_in", f"@run/{run['id']}:vz_in", f"@run/{copy}:vz_in"],
        }
        _, [(_, one), (_, same), (_, twice)] = decoded(judged.get("series", asked).body)
        assert np.array_equal(one, same, equal_nan=True)
        assert twice == pytest.approx(2.0 * one, nan_ok=True)
        for wrong in ("@run/nothing:vz_in", f"@run/{copy}:nothing"):
            assert judged.get("series", {"f": flight, "s": [wrong]}).status in (400, 404)
    finally:
        shutil.rmtree(own)
    assert judged.get("series", {"f": flight, "s": [f"@run/{copy}:vz_in"]}).status == 404


def test_a_run_of_a_newer_version_is_named_and_costs_no_other(judged: Server) -> None:
    newer = judged.data.with_name(f"{judged.data.name}.studio") / "runs" / "newer"
    newer.mkdir()
    (newer / "run.json").write_text(json.dumps({"format": "flysid-run", "version": 999}), "utf-8")
    try:
        listed = judged.get("runs").json
        assert len(listed["runs"]) == 1
        [damaged] = listed["damaged"]
        assert damaged["run"] == str(newer)
        assert "newer" in damaged["reason"]
    finally:
        shutil.rmtree(newer)


def test_a_port_in_use_and_a_folder_that_is_no_data(server: Server, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("x")
    (tmp_path / "log.bin").write_bytes(b"x")
    for words, said in (
        ([str(tmp_path / "d"), "--port", str(server.port)], "leave out --port"),
        ([str(tmp_path / "full")], "not an ingested folder"),
        ([str(tmp_path / "log.bin")], "flysid ingest"),
    ):
        ended = subprocess.run(
            [sys.executable, "-m", "flysid", "studio", *words, "--no-open"],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert ended.returncode == 2
        assert said in ended.stderr
