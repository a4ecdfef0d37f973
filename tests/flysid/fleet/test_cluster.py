"""Dask as the engine: the same lake, no secret on the way, and no Dask where nobody asked for it."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from flysid.errors import PlaceError, UsageError
from flysid.fleet import cluster as clusters
from flysid.fleet.cluster import Cluster, connected
from flysid.fleet.ingest_many import find, ingest
from flysid.fleet.lakes import create_lake
from flysid.fleet.reading import Log, Outcome, Settings, ingest_batch
from flysid.fleet.upkeep import check
from flysid.place import Place
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
        with connected(workers=2) as cluster:
            yield cluster


def kill_once(logs: Sequence[Log], settings: Settings) -> list[Outcome]:
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
