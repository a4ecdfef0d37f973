"""Small logs in one warm process: flysid and a peer in turn, CPU seconds, medians.

python -m bench.small_logs [-n 15] [-k words]

ULogs beside pyulog, telemetry and DataFlash beside pymavlink's `recv_match` loop, tables beside pandas. The
layout of a table is found anew at each reading, as it is in the first log of a process.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from bench.harness import LOGS

TABLE_BYTES = (50_000, 500_000, 3_000_000)
DATAFLASH = LOGS / "dataflash" / "sitl_copter_49s.BIN"
DATAFLASH_BYTES = 50_000
TABLE = LOGS / "ardrone" / "ardrone2_flight_nav_198hz.parquet"


def read_with_pyulog(path: Path) -> object:
    """The log as pyulog keeps it."""
    from pyulog import ULog

    with contextlib.redirect_stdout(io.StringIO()):
        return ULog(str(path))


def read_with_pymavlink(path: Path) -> object:
    """Every message of the log; none is kept."""
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    count = 0
    while log.recv_match() is not None:
        count += 1
    return count


def read_with_pandas(path: Path) -> object:
    """The table as a data frame."""
    import pandas as pd

    return pd.read_csv(path)


def cases(folder: Path) -> Iterator[tuple[Path, Callable[[Path], object]]]:
    """Logs of `../shared/logs`, and what reads them too."""
    for path in sorted((LOGS / "ulog").glob("[pq]*.ulg")):
        yield path, read_with_pyulog
    for path in sorted((LOGS / "tlog").glob("sitl_copter_*.tlog")):
        yield path, read_with_pymavlink
    if DATAFLASH.exists():
        begun = folder / "sitl_copter_50kB.bin"
        begun.write_bytes(DATAFLASH.read_bytes()[:DATAFLASH_BYTES])
        yield begun, read_with_pymavlink
        yield DATAFLASH.with_name("copter_437s.bin"), read_with_pymavlink
    if TABLE.exists():
        import pandas as pd

        whole = pd.read_parquet(TABLE).to_csv(index=False).encode()
        for size in TABLE_BYTES:
            table = folder / f"ardrone2_flight_nav_198hz_{size // 1000}kB.csv"
            table.write_bytes(whole[: whole.rindex(b"\n", 0, size) + 1])
            yield table, read_with_pandas


def read_with_flysid(path: Path) -> object:
    """The log as flysid keeps it, without what an earlier reading of the same file left behind."""
    import flysid
    from flysid.ingest.formats.csv.layouts import layout_of

    layout_of.cache_clear()
    return flysid.read(path)


def cpu_s(read: Callable[[Path], object], path: Path) -> float:
    """CPU seconds of one reading."""
    began = time.process_time()
    read(path)
    return time.process_time() - began


def main() -> None:
    """One line per log."""
    import flysid

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-n", type=int, default=15, help="readings of each log by each reader")
    parser.add_argument("-k", default="", help="only logs whose name holds these words")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for path, peer in cases(Path(folder)):
            if options.k not in path.name:
                continue
            streams = len(flysid.read(path).streams)
            peer(path)
            pairs = [(cpu_s(read_with_flysid, path), cpu_s(peer, path)) for _ in range(options.n)]
            ours, theirs = (statistics.median(each) for each in zip(*pairs, strict=True))
            print(
                f"{path.name:55} {path.stat().st_size / 1e6:5.2f} MB {streams:4} streams "
                f"{1e3 * ours:7.1f} ms, {peer.__name__.removeprefix('read_with_')} {1e3 * theirs:7.1f} ms: "
                f"{theirs / ours:.2f} x",
                flush=True,
            )


if __name__ == "__main__":
    main()
