"""Logs from a bucket into a lake: once each, whatever happens, and read again as any folder."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import flysid
from flysid.errors import FlysidError, PlaceError, UsageError
from flysid.fleet import reading
from flysid.fleet.ingest_many import Threads, batched, find, ingest
from flysid.fleet.lakes import create_lake, open_lake
from flysid.fleet.reading import LogAddress, Settings
from flysid.fleet.upkeep import check
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.flighttable import facts_in, open_table, rows_of, select
from flysid.ingest.lake.workers import Bounds
from flysid.place import Place
from tests.azureserver import KEY
from tests.flysid.fleet.fleet_logs import fill, run, table
from tests.s3server import SECRET, S3Server

VEHICLE = r"v\d+"
SECRETS = (SECRET, KEY)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own for every test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def ingested(inbox: str, lake: str, **more: Any) -> list[reading.LogOutcome]:
    """What became of every log of a bucket."""
    settings = Settings(lake, vehicle_in=VEHICLE, **({"bounds": None} | more))
    create_lake(lake)
    return list(ingest(find([inbox], lake), settings, Threads(1)))


def objects(lake: str) -> dict[str, bytes]:
    """Everything in a lake."""
    place = Place(lake)
    return {found.key: place.read(found.key) for found in place.list()}


def test_a_bucket_becomes_a_lake_that_reads_as_a_folder_does(bucket: str, tmp_path: Path) -> None:
    fill(f"{bucket}/in", 3)
    Place(bucket).put("in/notes.pdf", b"%PDF")
    done = run("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "--vehicle-in", VEHICLE, "-j", 1)
    assert done.exit_code == 0, done.output
    assert "3 ingested" in done.stderr
    assert "ignored, not logs: notes.pdf" in done.stderr
    assert [line.rpartition("-")[0] for line in done.stdout.split()] == ["flight00", "flight02", "flight01"]

    for n in range(3):
        (tmp_path / f"flight{n:02d}.csv").write_bytes(table(n))
    list(ingest_logs(find_logs(sorted(tmp_path.glob("*.csv"))), tmp_path / "data", bounds=None))
    here = flysid.open(tmp_path / "data")
    there = flysid.open(f"{bucket}/lake")
    assert [f.sha256 for f in here.facts] == [f.sha256 for f in there.facts]
    for ours, theirs in zip(here.facts, there.facts, strict=True):
        assert here.flight(ours.id).streams == there.flight(theirs.id).streams

    one = flysid.open(f"{bucket}/lake", where="vehicle = 'v001' and rows > 10")
    assert [facts.log for facts in one.facts] == ["flight01.csv"]
    assert one.logs[0].table("table", ["command"]).num_rows == 60
    with pytest.raises(UsageError, match="No field named colour") as caught:
        flysid.open(f"{bucket}/lake", where="colour = 'red'")
    assert "vehicle, firmware" in caught.value.hint
    assert check(open_lake(f"{bucket}/lake")).is_whole


def test_what_is_committed_is_not_fetched_again(store: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fill(f"{store}/in", 2)
    Place(store).put("in/copy.csv", table(0))
    Place(store).put("in/bad.tlog", bytes(range(256)) * 40)
    first = ingested(f"{store}/in", f"{store}/lake")
    assert sorted(o.status for o in first) == ["duplicate", "ingested", "ingested", "quarantined"]
    before = objects(f"{store}/lake")

    def refuse(*_: object) -> None:
        raise AssertionError("a log was fetched")

    monkeypatch.setattr(Place, "fetch", refuse)
    found = find([f"{store}/in"], f"{store}/lake")
    assert (found.waiting, found.known, found.quarantined) == ((), 3, 1)
    assert ingested(f"{store}/in", f"{store}/lake") == []
    assert objects(f"{store}/lake") == before
    assert [log.name for log in find([f"{store}/in"], f"{store}/lake", retry=True).waiting] == ["bad.tlog"]


def test_late_and_changed_logs_are_taken_and_old_arrivals_left(bucket: str) -> None:
    from datetime import UTC, datetime, timedelta

    fill(f"{bucket}/in", 1)
    ingested(f"{bucket}/in", f"{bucket}/lake")
    Place(bucket).put("in/v000/flight00.csv", table(7))  # the same name, other content
    Place(bucket).put("in/v009/late.csv", table(8))
    later = datetime.now(UTC) + timedelta(hours=1)
    assert find([f"{bucket}/in"], f"{bucket}/lake", since=later).waiting == ()
    outcomes = ingested(f"{bucket}/in", f"{bucket}/lake")
    assert sorted((o.log.name, o.status) for o in outcomes) == [
        ("flight00.csv", "ingested"),
        ("late.csv", "ingested"),
    ]
    assert len(flysid.open(f"{bucket}/lake")) == 3


def test_patterns_single_objects_and_a_lake_within_the_bucket(bucket: str) -> None:
    fill(bucket, 4)
    ingested(f"{bucket}/v000/flight00.csv", f"{bucket}/lake")
    names = [log.name for log in find([f"{bucket}/v*/flight0[12].csv"], f"{bucket}/lake").waiting]
    assert names == ["flight02.csv", "flight01.csv"]
    names = [log.name for log in find([bucket], f"{bucket}/lake").waiting]
    assert sorted(names) == ["flight01.csv", "flight02.csv", "flight03.csv"]
    with pytest.raises(UsageError, match="no flight log"):
        find([f"{bucket}/nothing"], f"{bucket}/lake")


def test_equal_logs_give_equal_bytes(bucket: str) -> None:
    fill(f"{bucket}/in", 2)
    ingested(f"{bucket}/in", f"{bucket}/one")
    ingested(f"{bucket}/in", f"{bucket}/two")
    one, two = objects(f"{bucket}/one"), objects(f"{bucket}/two")
    same = {key for key in one if key.startswith("flights/")}
    assert len(same) == 4
    assert {key: one[key] for key in same} == {key: two[key] for key in two if key.startswith("flights/")}


def test_two_ingests_at_once_commit_each_flight_once(store: str) -> None:
    fill(f"{store}/in", 6)
    create_lake(f"{store}/lake")
    with ThreadPoolExecutor(2) as pool:
        both = [pool.submit(ingested, f"{store}/in", f"{store}/lake") for _ in range(2)]
        outcomes = [outcome for one in both for outcome in one.result()]
    assert {o.status for o in outcomes} <= {"ingested", "unchanged"}
    assert sum(o.status == "ingested" for o in outcomes) == 6
    state = check(open_lake(f"{store}/lake"))
    assert state.is_whole
    assert len(state.flights) == 6
    assert open_table(Place(f"{store}/lake")).to_pyarrow_table().num_rows == 6


def test_a_catalogue_is_made_again_from_the_manifests(bucket: str) -> None:
    fill(f"{bucket}/in", 3)
    ingested(f"{bucket}/in", f"{bucket}/lake")
    place = Place(f"{bucket}/lake")
    before = facts_in(select(place))
    place.delete([found.key for found in place.list("catalog")])
    place.put("flights/ab/abababababababab/123456789abc/lost.parquet", b"half a flight")
    done = run("fleet", "check", f"{bucket}/lake")
    assert done.exit_code == 0  # click's runner; the code is what the verb returns
    assert "not whole" in done.stdout
    assert "3 flights missing from the catalogue" in done.stdout
    assert "1 objects that belong to no flight" in done.stdout
    done = run("fleet", "check", f"{bucket}/lake", "--repair", "--older", "0s")
    assert "3 flights, whole" in done.stdout
    assert facts_in(select(place)) == before
    assert [f.sha256 for f in check(place).flights] == [f.sha256 for f in before]


def test_a_missing_table_is_found_and_a_damaged_manifest_too(bucket: str) -> None:
    fill(f"{bucket}/in", 2)
    ingested(f"{bucket}/in", f"{bucket}/lake")
    place = Place(f"{bucket}/lake")
    keys = [found.key for found in place.list("flights")]
    place.delete([next(key for key in keys if key.endswith(".parquet"))])
    assert len(check(place).missing) == 1
    place.put(next(key for key in reversed(keys) if key.endswith("manifest.json")), b"{}")
    assert len(check(place).damaged) == 1


def test_duckdb_polars_and_pandas_read_the_same_rows(bucket: str) -> None:
    duckdb = pytest.importorskip("duckdb")
    polars = pytest.importorskip("polars")
    fill(f"{bucket}/in", 3)
    ingested(f"{bucket}/in", f"{bucket}/lake")
    table = open_table(Place(f"{bucket}/lake"))
    expected = sorted(facts.id for facts in flysid.open(f"{bucket}/lake").facts)
    assert sorted(table.to_pandas()["flight"]) == expected
    assert sorted(polars.scan_delta(table).select("flight").collect()["flight"]) == expected
    flights = table.to_pyarrow_dataset()  # noqa: F841 - DuckDB finds it by its name
    found = duckdb.sql(
        "select vehicle, sum(rows) as n from flights group by vehicle order by vehicle"
    ).fetchall()
    assert found == [("v000", 120), ("v001", 60)]


def test_a_fleet_is_listed_and_asked(bucket: str, tmp_path: Path) -> None:
    fill(f"{bucket}/in", 3)
    ingested(f"{bucket}/in", f"{bucket}/lake")
    shown = run("fleet", "ls", f"{bucket}/lake", "--vehicle", "v001").stdout
    assert "flight01-" in shown
    assert "flight00-" not in shown
    told = run("fleet", "ls", f"{bucket}/lake", "--by", "vehicle", "--json").stdout
    assert [json.loads(line)["flights"] for line in told.splitlines()] == [2, 1]
    refused = run("fleet", "ls", f"{bucket}/lake", "--sql", f"copy flights to '{tmp_path}/x.csv'")
    assert isinstance(refused.exception, UsageError)
    (tmp_path / "a.csv").write_bytes(table(1))
    run("ingest", tmp_path / "a.csv", "-o", tmp_path / "data", "--vehicle-in", "(?P<name>a).csv")
    assert "a  " in run("fleet", "ls", tmp_path / "data", "--vehicle", "a").stdout


def test_verbs_read_lakes_and_logs_at_addresses(bucket: str, tmp_path: Path) -> None:
    fill(f"{bucket}/in", 2)
    ingested(f"{bucket}/in", f"{bucket}/lake")
    assert "v000" in run("ls", f"{bucket}/lake").stdout
    assert "source_url" in run("show", f"{bucket}/lake", "flight00").stdout
    assert "60 rows" in run("show", f"{bucket}/in/v000/flight00.csv", "table").stdout
    assert isinstance(run("ls", f"{bucket}/in").exception, UsageError)
    out = tmp_path / "out.csv"
    assert run("export", f"{bucket}/in/v000/flight00.csv", "--to", "csv", "-o", out).exit_code == 0
    assert out.exists()


def test_a_flight_that_was_read_again_is_fetched_again(bucket: str) -> None:
    fill(f"{bucket}/in", 1)
    ingested(f"{bucket}/in", f"{bucket}/lake")
    old = flysid.open(f"{bucket}/lake").flights[0]
    settings = Settings(f"{bucket}/lake", bounds=None, vehicle_in="flight", replace=True)
    logs = find([f"{bucket}/in"], f"{bucket}/lake", force=True)
    [outcome] = ingest(logs, settings, Threads(1))
    assert outcome.status == "ingested"
    new = flysid.open(f"{bucket}/lake").flights[0]
    assert (old.info["vehicle_name"], new.info["vehicle_name"]) == ("v000", "flight")
    assert check(Place(f"{bucket}/lake")).is_whole


def end_of_process(*_: object, **__: object) -> Any:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_log_that_kills_its_process_twice_goes_to_quarantine(
    bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(f"{bucket}/in", 1)
    monkeypatch.setattr(reading, "read_log", end_of_process)
    [outcome] = ingested(f"{bucket}/in", f"{bucket}/lake", bounds=Bounds())
    assert outcome.status == "quarantined"
    assert outcome.reason.endswith("was killed by the system (out of memory?), 2 times")
    [(key, text)] = [(k, t) for k, t in objects(f"{bucket}/lake").items() if k.startswith("quarantine/")]
    assert json.loads(text)["reason"] == outcome.reason
    assert "lake" not in json.loads(text)
    assert key.split("/")[1] == flysid.__version__


def test_a_client_that_is_killed_loses_nothing_and_repeats_nothing(bucket: str) -> None:
    fill(f"{bucket}/in", 8)
    command = [sys.executable, "-m", "flysid", "ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", "1"]
    client = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    place = Place(f"{bucket}/lake")
    end = time.monotonic() + 60
    while time.monotonic() < end and sum("manifest" in f.key for f in place.list("flights")) < 2:
        time.sleep(0.02)
    client.kill()
    client.wait()
    done = run("ingest", f"{bucket}/in", "-o", f"{bucket}/lake", "-j", 1)
    assert "not done" not in done.stderr
    state = check(place)
    assert state.is_whole, state
    assert len(state.flights) == 8


def test_a_store_that_is_down_leaves_logs_waiting(
    bucket: str, s3_server: S3Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tests.s3server import free_port

    fill(f"{bucket}/in", 1)
    found = find([f"{bucket}/in"], f"{bucket}/lake")
    assert s3_server.endpoint == os.environ["AWS_ENDPOINT_URL"]
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{free_port()}")
    [outcome] = reading.ingest_batch(found.waiting, Settings(f"{bucket}/lake"))
    assert (outcome.status, "no connection" in outcome.reason) == ("waiting", True)
    with pytest.raises(PlaceError):
        find([f"{bucket}/in"], f"{bucket}/lake")


def test_no_secret_is_in_any_object_message_or_cache(store: str, cache: Path) -> None:
    fill(f"{store}/in", 2)
    done = run("ingest", f"{store}/in", "-o", f"{store}/lake", "-j", 1, "--progress", "json", "--json")
    flysid.open(f"{store}/lake").flight("flight00")
    files = [path.read_bytes() for path in cache.rglob("*") if path.is_file()]
    assert files
    for content in (*objects(f"{store}/lake").values(), done.output.encode(), *files):
        assert not any(secret.encode() in content for secret in SECRETS)


def test_options_of_a_lake_are_refused_where_none_is(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(table(1))
    done = run("ingest", tmp_path / "a.csv", "-o", tmp_path / "data", "--since", "2026-01-01")
    assert isinstance(done.exception, UsageError)
    assert isinstance(run("ingest", "s3://b/in", "-o", tmp_path / "data").exception, UsageError)
    assert isinstance(run("ingest", "a.csv", "--vehicle-in", "(").exception, FlysidError)


def test_batches_are_full_where_logs_are_many_and_shared_where_they_are_few() -> None:
    logs = [LogAddress(f"s3://b/{n}", 1 << 20) for n in range(1000)]
    assert {len(part) for part in batched(logs, 32, 2)} == {32, 1000 % 32}
    assert [len(part) for part in batched(logs[:8], 32, 2)] == [1] * 8
    assert [len(part) for part in batched([LogAddress("s3://b/x", 60 << 20)] * 9, 32, 1)] == [1] * 9
    assert batched([], 32, 2) == []


def test_rows_and_facts_are_each_others_image(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes(table(1))
    list(ingest_logs(find_logs([tmp_path / "a.csv"]), tmp_path / "data", bounds=None))
    facts = flysid.open(tmp_path / "data").facts
    assert facts_in(rows_of(facts)) == facts


@pytest.mark.usefixtures("arx_alone")
def test_a_run_that_was_fitted_to_a_lake_is_validated_on_it(bucket: str, tmp_path: Path) -> None:
    fill(f"{bucket}/in", 3, vehicles=1)
    ingested(f"{bucket}/in", f"{bucket}/lake")
    words = ["--from", "command", "--to", "response", "--models", "line"]
    fitted = run("fit", f"{bucket}/lake", *words, "-o", tmp_path / "run", "-q")
    assert fitted.exception is None, fitted.output
    assert json.loads((tmp_path / "run" / "run.json").read_text())["data"] == f"{bucket}/lake"
    judged = run("validate", tmp_path / "run", "-q", "--json")
    assert judged.exception is None, judged.output
    assert json.loads(judged.stdout)["channels"]
