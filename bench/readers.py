"""Readers that benchmarks compare: each takes a path and returns what it keeps."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any


def flysid_tables(path: Path) -> Any:
    """The whole log as Arrow tables in memory."""
    import flysid

    return flysid.read(path)


def flysid_parquet(path: Path) -> Any:
    """The log as parquet on disk, in bounded memory."""
    from flysid import store
    from flysid.ingest.formats.base import Limits, source_of
    from flysid.ingest.formats.opening import open_log
    from flysid.ingest.formats.registry import detect

    folder = Path(tempfile.mkdtemp(dir=path.parent))
    try:
        with open_log(path) as log:
            fmt = detect(log.head, log.name)
            data = store.create_data_folder(folder / "data")
            return store.write_flight(data, source_of(log.view, log.name, fmt), log.read(fmt, Limits()))
    finally:
        shutil.rmtree(folder)


def _prepare_flysid() -> None:
    import pyarrow.parquet

    import flysid.store
    from flysid.ingest.formats.mavlink.dialect import load_dialect
    from flysid.ingest.formats.registry import all_formats

    del pyarrow, flysid
    all_formats()
    load_dialect()


def _prepare_pymavlink() -> None:
    import pandas
    from pymavlink import DFReader, mavutil

    del pandas, DFReader
    mavutil.set_dialect("ardupilotmega")


def pymavlink_loop(path: Path) -> Any:
    """pymavlink's recv_match loop that keeps nothing."""
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(path))
    count = 0
    while log.recv_match() is not None:
        count += 1
    return count


def pymavlink_pandas(path: Path) -> Any:
    """All messages as dicts, one pandas table per message type."""
    import pandas as pd
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(path))
    rows: dict[str, list[dict[str, Any]]] = {}
    while (message := log.recv_match()) is not None:
        row = message.to_dict()
        row["timestamp"] = message._timestamp
        rows.setdefault(message.get_type(), []).append(row)
    return {name: pd.DataFrame(items) for name, items in rows.items()}


def dfreader_pandas(path: Path) -> Any:
    """All messages as dicts, one pandas table per message type."""
    import pandas as pd
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(path))
    rows: dict[str, list[dict[str, Any]]] = {}
    while (message := log.recv_msg()) is not None:
        rows.setdefault(message.get_type(), []).append(message.to_dict())
    return {name: pd.DataFrame(items) for name, items in rows.items()}


for _reader in (flysid_tables, flysid_parquet):
    _reader.prepare = _prepare_flysid  # type: ignore[attr-defined]
for _reader in (pymavlink_loop, pymavlink_pandas, dfreader_pandas):
    _reader.prepare = _prepare_pymavlink  # type: ignore[attr-defined]
