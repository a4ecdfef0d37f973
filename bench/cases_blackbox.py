"""Blackbox, against another decoder and against the same loops in plain Python."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from bench.harness import LOGS, Case

HERE = "bench.cases_blackbox"
FLIGHTS = "blackbox/greenreaper_flight*.bfl"
ONE = "blackbox/greenreaper_flight24.bfl"
START = b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n"


def build(path: Path) -> None:
    """Ten flights of one craft in one file, as flash memory holds them."""
    path.write_bytes(b"".join(log.read_bytes() for log in sorted(LOGS.glob(FLIGHTS))))


def build_one(path: Path) -> None:
    """One flight of 107 s."""
    path.write_bytes((LOGS / ONE).read_bytes())


def _prepare_flysid() -> None:
    from tests.samplelogs import blackbox

    _read(blackbox.build())  # the compiled loops are loaded


def _read(blob: bytes) -> Any:
    from flysid.ingest.formats.base import Limits, collect
    from flysid.ingest.formats.registry import FORMATS

    return collect(memoryview(blob), "log.bbl", FORMATS["blackbox"], Limits())


def flysid_tables(path: Path) -> Any:
    """The whole file as Arrow tables in memory."""
    import flysid

    return flysid.read(path)


def _prepare_plain() -> None:
    os.environ["NUMBA_DISABLE_JIT"] = "1"  # numba is not imported yet


def plain_python(path: Path) -> Any:
    """The same reader with its loops not compiled."""
    return flysid_tables(path)


def chirp_core(path: Path) -> Any:
    """All frames of all logs by betaflight-chirp-core, as lists."""
    from betaflight_chirp_core.decoder import FlightLogParser

    blob = path.read_bytes()
    starts = [match.start() for match in re.finditer(re.escape(START), blob)]
    kept = []
    for start, stop in zip(starts, [*starts[1:], len(blob)], strict=True):
        log = FlightLogParser(blob, start, stop)
        log.parse_header()
        log.parse_data(raw=False)
        kept.append(log.main_frames)
    return kept


def _prepare_chirp_core() -> None:
    import betaflight_chirp_core.decoder

    del betaflight_chirp_core


flysid_tables.prepare = _prepare_flysid  # type: ignore[attr-defined]
plain_python.prepare = _prepare_plain  # type: ignore[attr-defined]
chirp_core.prepare = _prepare_chirp_core  # type: ignore[attr-defined]

OURS = f"{HERE}:flysid_tables"
CASES = (
    Case(
        "blackbox, 30 MB, to Arrow tables",
        "flights.bfl",
        build,
        OURS,
        {"betaflight-chirp-core": (f"{HERE}:chirp_core", 50.0)},
        needs=ONE,
    ),
    Case(
        "blackbox, 2.4 MB, to Arrow tables",
        "flight.bfl",
        build_one,
        OURS,
        {"the same loops in plain Python": (f"{HERE}:plain_python", 50.0)},
        needs=ONE,
    ),
)
