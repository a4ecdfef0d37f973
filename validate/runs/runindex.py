"""One parquet index of the runs below a folder, so that listing hundreds of them opens one file.

`<folder>/.flysid-runs.parquet` has a row per channel of a run, and the size and time of the two files it was
read from. Rows whose files have changed are read again, rows of runs that vanished are dropped, and the index
is replaced whole (temporary file, fsync, rename). It holds nothing that the runs do not: without it, damaged,
or in a folder that cannot be written, the listing is the same and slower.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from flysid.errors import StoreError
from flysid.extras import Extra, extra
from flysid.files import write_atomically
from flysid.foreign import inner_path
from flysid.validate.runs.history import RunChannel, find_runs, run_channels
from flysid.validate.runs.run import DOCUMENT, REPORT, RUN_FILE

INDEX = ".flysid-runs.parquet"
VERSION = b"3"
Stamp = tuple[int, int, int, int]
Indexed = dict[str, tuple[Stamp, list[RunChannel]]]


def list_runs(folders: Sequence[str | Path]) -> tuple[list[RunChannel], list[StoreError]]:
    """Every channel of every run in and below `folders`, and why runs were left out.

    Raises UsageError: one of `folders` does not exist, or no run was found.
    """
    find_runs(folders)
    channels: dict[tuple[str, str], RunChannel] = {}
    damaged: list[StoreError] = []
    for folder in dict.fromkeys(map(Path, folders)):
        found, broken = _list_runs(folder)
        channels |= {(c.folder, c.channel): c for c in found}
        damaged += broken
    return list(channels.values()), damaged


def _list_runs(root: Path) -> tuple[list[RunChannel], list[StoreError]]:
    from flysid.validate.runs.history import walk

    known = _read(root)
    now = Indexed()
    damaged = []
    for folder in sorted(walk(root)):
        name = os.path.relpath(folder, root)
        stamp = _stamp(folder)
        if name in known and known[name][0] == stamp:
            now[name] = known[name]
            continue
        try:
            now[name] = stamp, run_channels(folder)
        except StoreError as error:
            damaged.append(error)
    if now != known:
        extra(Extra.INDEX, partial(_write, root, now), None, str(root))
    listed = [replace(c, folder=str(root / name)) for name, (_, own) in now.items() for c in own]
    return listed, damaged


def _stamp(folder: Path) -> Stamp:
    """(time, size) of run.json and of the report's document; zeros where there is none."""
    numbers: list[int] = []
    for path in (folder / RUN_FILE, folder / REPORT / DOCUMENT):
        try:
            state = path.stat()
            numbers += [state.st_mtime_ns, state.st_size]
        except OSError:
            numbers += [0, 0]
    a, b, c, d = numbers
    return a, b, c, d


def _read(root: Path) -> Indexed:
    """The index, or nothing where it is absent, damaged or of another version."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    found: Indexed = {}
    try:
        path = inner_path(root, INDEX, root)
        table = pq.read_table(io.BytesIO(path.read_bytes()))
        if (table.schema.metadata or {}).get(b"flysid-runs") != VERSION:
            return {}
        for row in table.to_pylist():
            stamp = tuple(int(v) for v in row.pop("stamp"))
            name = str(row.pop("run"))
            found.setdefault(name, (stamp, []))[1].append(_channel(row))  # type: ignore[arg-type]
    except (OSError, StoreError, pa.ArrowException, LookupError, TypeError, ValueError):
        return {}
    return found


def _channel(row: Mapping[str, Any]) -> RunChannel:
    rmse = dict(zip(row["models"], row["rmse"], strict=True))
    plain = {k: v for k, v in row.items() if k not in ("models", "rmse")}
    return RunChannel(folder="", rmse=rmse, **plain)


def _write(root: Path, runs: Indexed) -> None:
    """Replace the index; a folder that cannot be written has none."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = pa.schema(
        [
            ("run", pa.string()), ("stamp", pa.list_(pa.int64())), ("recipe", pa.string()),
            ("channel", pa.string()), ("fitted_at", pa.string()), ("models", pa.list_(pa.string())),
            ("rmse", pa.list_(pa.float64())), ("unit", pa.string()), ("change_pct", pa.float64()),
            ("verdict", pa.string()), ("held_out", pa.string()), ("baseline", pa.string()),
        ],
        metadata={b"flysid-runs": VERSION},
    )  # fmt: skip
    rows = [_row(name, stamp, c) for name, (stamp, own) in runs.items() for c in own]
    sink = io.BytesIO()
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), sink, compression="zstd")
    try:
        write_atomically(root / INDEX, sink.getvalue())
    except OSError:
        return


def _row(name: str, stamp: Stamp, c: RunChannel) -> dict[str, Any]:
    body = c.to_dict() | {"run": name, "stamp": list(stamp)}
    body |= {"models": list(c.rmse), "rmse": list(c.rmse.values())}
    return {k: v for k, v in body.items() if k not in ("folder", "rank")}
