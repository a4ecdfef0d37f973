"""`make bench-ingest`: readers against their peers, in CPU seconds, medians, on files built from real logs.

    python -m bench.bench_ingest [-n 3] [-k words] [--json]
    python -m bench.bench_ingest --memory [-k words] [--sizes 150,600]
    python -m bench.bench_ingest --folder [-n 3]

Cases live in the `CASES` of every `bench/cases_*.py`. Ours and each peer run in turn, `n` times, every
run in a process of its own; the ratio of the medians is what counts, not the seconds of this machine. Files
are built in `.bench` when they are not there. Ends with 1 where a ratio that was promised is missed.
`--memory` ingests a file of every format and size to parquet and prints the peak memory: see `memory`.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from typing import Any

from bench import many_flights, memory
from bench.harness import LOGS, ROOT, WORK, Case, Measured, measure


def all_cases() -> list[Case]:
    """The cases of every `cases_*.py` in this folder, by file name."""
    found: list[Case] = []
    for path in sorted((ROOT / "bench").glob("cases_*.py")):
        found.extend(importlib.import_module(f"bench.{path.stem}").CASES)
    return found


def run_case(case: Case, times: int) -> list[dict[str, Any]]:
    """One row for us and one per peer; empty where the log to build from is absent."""
    if not (LOGS / case.needs).exists():
        print(f"skipped: {case.name}: ../shared/logs/{case.needs} is not there", file=sys.stderr)
        return []
    path = WORK / case.file
    if not path.exists():
        WORK.mkdir(exist_ok=True)
        print(f"building {path.name}", file=sys.stderr)
        partial = path.with_name(path.name + ".partial")
        case.build(partial)
        partial.replace(path)
    megabytes = path.stat().st_size / 1e6
    ours = measure(case.ours, path, cold=case.cold, times=times)
    rows = [_row(case.name, "flysid", ours, megabytes)]
    for label, (target, promised) in case.peers.items():
        peer = measure(target, path, cold=case.cold, times=times)
        rows.append(
            {
                **_row(case.name, label, peer, megabytes),
                "ratio": peer.cpu_s / ours.cpu_s,
                "promised": promised,
            }
        )
    return rows


def _row(case: str, reader: str, measured: Measured, megabytes: float) -> dict[str, Any]:
    return {
        "case": case,
        "reader": reader,
        "cpu_s": round(measured.cpu_s, 3),
        "peak_mb": round(measured.peak_mb),
        "peak_per_file": round(measured.peak_mb / megabytes, 2),
    }


def show(row: dict[str, Any]) -> str:
    """One line of the table."""
    ratio = f"{row['ratio']:7.1f} x   (promised {row['promised']:g} x)" if "ratio" in row else ""
    return (
        f"{row['case']:36} {row['reader']:36} {row['cpu_s']:8.2f} s {row['peak_mb']:6,} MB "
        f"{row['peak_per_file']:5.1f} x file {ratio}"
    )


def main() -> int:
    """Run the cases that the words select."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-n", type=int, default=3, help="runs of each reader")
    parser.add_argument("-k", default="", help="only cases whose name holds these words")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--memory", action="store_true", help="peak memory of ingesting every format")
    parser.add_argument("--sizes", default="150,600", help="with --memory: sizes of the files in MB")
    parser.add_argument("--folder", action="store_true", help="a folder of 10,000 flights; small logs")
    options = parser.parse_args()
    if options.folder:
        return many_flights.main(options.n)
    if options.memory:
        return memory.main(options.k, [int(size) for size in options.sizes.split(",")])
    rows: list[dict[str, Any]] = []
    for case in all_cases():
        if options.k.lower() in case.name.lower():
            for row in run_case(case, options.n):
                rows.append(row)
                print(show(row), file=sys.stderr if options.json else sys.stdout, flush=True)
    if options.json:
        print(json.dumps(rows, indent=1))
    return 1 if any(row.get("ratio", 1e9) < row.get("promised", 0) for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
