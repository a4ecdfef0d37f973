"""Small ULogs in one warm process: flysid and pyulog in turn, CPU seconds, medians.

python -m bench.small_ulogs [-n 15]
"""

from __future__ import annotations

import argparse
import contextlib
import io
import statistics
import time
from collections.abc import Callable
from pathlib import Path

from bench.harness import LOGS


def read_with_pyulog(path: Path) -> object:
    """The log as pyulog keeps it."""
    from pyulog import ULog

    with contextlib.redirect_stdout(io.StringIO()):
        return ULog(str(path))


def cpu_s(read: Callable[[Path], object], path: Path) -> float:
    """CPU seconds of one reading."""
    began = time.process_time()
    read(path)
    return time.process_time() - began


def main() -> None:
    """One line per log of `../shared/logs/ulog`."""
    import flysid

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-n", type=int, default=15, help="readings of each log by each reader")
    times = parser.parse_args().n
    for path in sorted((LOGS / "ulog").glob("[pq]*.ulg")):
        streams = len(flysid.read(path).streams)
        pairs = [(cpu_s(flysid.read, path), cpu_s(read_with_pyulog, path)) for _ in range(times)]
        ours, theirs = (statistics.median(each) for each in zip(*pairs, strict=True))
        print(
            f"{path.name:55} {path.stat().st_size / 1e6:5.2f} MB {streams:4} streams "
            f"{1e3 * ours:7.1f} ms, pyulog {1e3 * theirs:7.1f} ms: {theirs / ours:.2f} x"
        )


if __name__ == "__main__":
    main()
