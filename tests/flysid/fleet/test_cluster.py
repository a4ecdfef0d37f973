"""Dask as the engine: the same lake, no secret on the way, and no Dask where nobody asked for it."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

import flysid
from flysid.errors import PlaceError, UsageError
from flysid.fleet import cluster as clusters
from flysid.fleet.cluster import Cluster, connect
from flysid.fleet.ingest_many import find, ingest
from flysid.fleet.lakes import create_lake
from flysid.fleet.models import vehicle_runs
from flysid.fleet.models.gather import gather
from flysid.fleet.models.triangle_store import Folder
from flysid.fleet.models.vehicle_runs import VehicleFit, fit_vehicles, run_files
from flysid.fleet.reading import LogAddress, LogOutcome, Settings, ingest_batch
from flysid.fleet.upkeep import check
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.lake.chosen_flights import vehicles
from flysid.ingest.synth.synth import WRITERS, Order, fly_one
from flysid.place import Place
from flysid.validate.runs.run import FitSettings
from tests.contest import linear_side
from tests.flysid.fleet.fleet_logs import fill, run
from tests.flysid.test_house import modules_after
from tests.s3server import SECRET, S3Server, free_port

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def two_workers(s3_server: S3Server) -> Iterator[Cluster]:
    """Two worker processes that reach the server."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in s3_server.environment.items():
            patch.setenv(name, value)
        with connect(workers=2) as cluster:
            yield cluster


def kill_once(logs: Sequence[LogAddress], settings: Settings) -> list[LogOutcome]:
    """Of all batches, the worker of one is killed after the first log, when half a flight more is there."""
    done = ingest_batch(logs[:1], settings)
    if Place(settings.lake).create("flights/killed", b"half a flight"):
        os.kill(os.getpid(), signal.SIGKILL)
    return [*done, *ingest_batch(logs[1:], settings)]


def test_killed_workers_lose_nothing_and_repeat_nothing(bucket: str, two_workers: Cluster) -> None:
    fill(f"{bucket}/in", 12)
    place = create_lake(f"{bucket}/lake")
    settings = Settings(str(place), bounds=None)
    fragile = Cluster(two_workers.client, do=kill_once)
    found = find([f"{bucket}/in"], str(place))
    outcomes = list(ingest(found, settings, fragile, batch=6))
    assert sorted(o.log.name for o in outcomes) == sorted(log.name for log in found.waiting)
    assert {o.status for o in outcomes} <= {"ingested", "unchanged"}
    place.delete(["flights/killed"])
    state = check(place)
    assert state.is_whole, state
    assert len(state.flights) == 12
    assert find([f"{bucket}/in"], str(place)).waiting == ()


def inverted(number: int) -> float:
    return 1.0 / number


def test_what_one_task_raises_costs_no_result_that_came_with_it(two_workers: Cluster) -> None:
    from distributed import wait

    futures = two_workers.client.map(inverted, [0, 1, 2], pure=False)
    wait(futures)
    found = clusters._sound([0, 1, 2], two_workers._results(futures))
    assert list(islice(found, 2)) == [(1, 1.0), (2, 0.5)]
    with pytest.raises(ZeroDivisionError):
        next(found)
    with pytest.raises(ZeroDivisionError):
        list(two_workers.each(inverted, [0], lambda _: ["inverted"]))


def test_no_secret_is_in_what_goes_to_the_workers(bucket: str, two_workers: Cluster) -> None:
    from distributed.protocol.pickle import dumps

    fill(f"{bucket}/in", 1)
    found = find([f"{bucket}/in"], f"{bucket}/lake")
    sent = (ingest_batch, found.waiting, Settings(f"{bucket}/lake"))
    assert SECRET in os.environ.values()
    assert SECRET.encode() not in dumps(sent)
    assert SECRET.encode() not in pickle.dumps(sent)
    create_lake(f"{bucket}/lake")
    [outcome] = two_workers.run([found.waiting], Settings(f"{bucket}/lake", bounds=None))
    assert SECRET.encode() not in pickle.dumps(outcome)


def test_workers_that_differ_are_refused(two_workers: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clusters, "__version__", "9.9")
    with pytest.raises(UsageError, match=r"here it is flysid 9\.9"):
        clusters._check_workers(two_workers.client, "tcp://s")


def test_workers_that_may_not_start_processes_are_refused() -> None:
    import dask
    from distributed import Client, LocalCluster

    with (
        dask.config.set({"distributed.worker.daemon": True}),
        LocalCluster(n_workers=1, host="127.0.0.1", dashboard_address=None) as local,
        Client(local) as client,
        pytest.raises(UsageError, match="may not start the processes") as caught,
    ):
        clusters._check_workers(client, "tcp://s")
    assert "DAEMON" in caught.value.hint


def test_where_no_scheduler_answers_the_error_says_how_to_start_one(bucket: str) -> None:
    fill(f"{bucket}/in", 1)
    address = f"tcp://127.0.0.1:{free_port()}"
    done = run("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "--cluster", address)
    assert isinstance(done.exception, PlaceError)
    assert "dask scheduler" in done.exception.hint


def test_without_a_cluster_nothing_of_dask_is_imported(bucket: str, tmp_path: Path) -> None:
    fill(f"{bucket}/in", 1)
    (tmp_path / "a.csv").write_text("time_s,u\n0,1\n1,2\n")
    ingests = [
        ["ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1", "-q"],
        ["ingest", str(tmp_path / "a.csv"), "-o", str(tmp_path / "data"), "-q"],
    ]
    code = "from flysid.cli import root\n"
    code += "\n".join(f"root.main({words}, standalone_mode=False)" for words in reversed(ingests))
    here = modules_after(code.rpartition("\n")[0])
    assert not here & {"dask", "distributed", "obstore", "deltalake"}
    assert not modules_after(code) & {"dask", "distributed"}
    asked = f"import flysid\nflysid.open('{bucket}/lake', where=\"vehicle <> 'x'\")"
    assert not modules_after(asked) & {"pandas", "dask"}  # either is memory that a catalogue does not need


@pytest.fixture
def small_fleet(bucket: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A lake of two vehicles with two flights each."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    order = Order("ardrone", "routine", 24.0, seed=3, sensor="autopilot", fleet=2, step_s=0.004)
    suffix, encode = WRITERS["ulog"]
    for i in range(4):
        recording = fly_one(order, i)
        Place(f"{bucket}/in").put(f"{recording.name}{suffix}", encode(recording))
    assert run("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1", "-q").exit_code == 0
    return f"{bucket}/lake"


def files_beside_arx(fit: VehicleFit) -> Mapping[str, bytes] | str:
    """A vehicle's run as a worker makes it, where only ARX competes: patches do not reach another process."""
    with linear_side("arx"):
        return run_files(fit)


@pytest.mark.usefixtures("arx_alone")
def test_models_of_a_fleet_are_the_same_from_workers_elsewhere(
    small_fleet: str, two_workers: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vehicle_runs, "run_files", files_beside_arx)
    lake = flysid.open(small_fleet)
    recipe = load_recipe("px4-effort")
    here = gather(lake, recipe, Folder(tmp_path / "here"), ("throttle_climb",))
    there = gather(lake, recipe, Folder(tmp_path / "there"), ("throttle_climb",), cluster=two_workers)
    assert there.read == here.read == 4
    for one, other in zip(*(g.parts["throttle_climb"] for g in (here, there)), strict=True):
        assert one.flight == other.flight
        np.testing.assert_array_equal(one.triangle.r, other.triangle.r)
    named = list(vehicles(lake))
    settings = FitSettings(channels=("throttle_climb",), models=("line",), rotate=False)
    for folder, cluster in (("one", None), ("two", two_workers)):
        done = fit_vehicles(lake, "px4-effort", tmp_path / folder, settings, named, cluster=cluster)
        assert not [why for why in done.values() if isinstance(why, str)]
    files = sorted((tmp_path / "one").rglob("throttle_climb/*.json"))
    assert len(files) >= 2 * len(named)
    for path in files:
        assert path.read_bytes() == (tmp_path / "two" / path.relative_to(tmp_path / "one")).read_bytes()
    refused = fit_vehicles(
        lake, "px4-effort", tmp_path / "no", replace(settings, channels=("none",)), named, cluster=two_workers
    )
    assert all(isinstance(why, str) for why in refused.values())


def test_the_verbs_take_a_cluster_for_an_address_alone(
    small_fleet: str, two_workers: Cluster, tmp_path: Path
) -> None:
    words = ["-r", "px4-effort", "-c", "throttle_climb"]
    scheduler = ["--cluster", two_workers.client.scheduler.address]
    done = run("fleet", "fit", small_fleet, *words, *scheduler)
    assert done.exit_code == 0, done.output
    assert "4 flights read" in done.stderr
    assert "cluster of 2 workers" in done.stderr
    (tmp_path / "a.csv").write_text("time_s,u\n0,1\n1,2\n")
    assert run("ingest", tmp_path / "a.csv", "-o", tmp_path / "data", "-q").exit_code == 0
    local = run("fleet", "changed", tmp_path / "data", *words, *scheduler)
    assert isinstance(local.exception, UsageError)
    assert "-j" in local.exception.hint
    both = run("fleet", "changed", small_fleet, *words, *scheduler, "--workers", "2")
    assert isinstance(both.exception, UsageError)
