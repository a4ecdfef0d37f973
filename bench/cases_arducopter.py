"""MAVLink telemetry and DataFlash, against pymavlink."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from bench.harness import LOGS, Case

TARGET_BYTES = 150_000_000
READERS = "bench.readers"


def build_tlog(path: Path) -> None:
    """A real flight over and over; arrival, time_boot_ms and time_usec go on rising, CRCs are made anew."""
    import fastcrc

    from flysid.ingest.formats.common.columns import as_array
    from flysid.ingest.formats.mavlink.dialect import load_dialect
    from flysid.ingest.formats.mavlink.frames import Scanner, plain_chain

    dialect = load_dialect()
    source = (LOGS / "tlog" / "sitl_copter_500s.tlog").read_bytes()
    frames, _ = Scanner(dialect.crc_extra, 8, plain_chain(dialect.crc_extra)).scan(
        as_array(source), 0, len(source)
    )
    seconds = 501
    ends = [*(frames.start[1:] - 8).tolist(), len(source)]
    columns = (frames.start, frames.message, frames.payload, frames.length, ends)
    plan = [
        (int(q), int(p), int(n), int(e), *_time_at(dialect, int(m)), bytes([dialect.crc_extra[m]]))
        for q, m, p, n, e in zip(*columns, strict=True)
    ]
    with path.open("wb") as out:
        for turn in range(-(-TARGET_BYTES // len(source))):
            copy = bytearray(source)
            for q, payload, size, end, at, width, unit, seed in plan:
                stamp = struct.unpack_from(">Q", copy, q - 8)[0]
                struct.pack_into(">Q", copy, q - 8, stamp + turn * seconds * 1_000_000)
                if width and at + width <= size:
                    where = payload + at
                    value = int.from_bytes(copy[where : where + width], "little") + turn * seconds * unit
                    copy[where : where + width] = (value % (1 << 8 * width)).to_bytes(width, "little")
                    crc = fastcrc.crc16.mcrf4xx(bytes(copy[q + 1 : payload + size]) + seed)
                    struct.pack_into("<H", copy, payload + size, crc)
                del end
            out.write(copy)


def _time_at(dialect: Any, message: int) -> tuple[int, int, int]:
    """(offset, width, ticks per second) of the time field of a message; width 0 where it has none."""
    dtype = dialect.layout(message).dtype
    for name, unit in (("time_boot_ms", 1000), ("time_usec", 1_000_000)):
        if name in (dtype.names or ()):
            return dtype.fields[name][1], dtype[name].itemsize, unit
    return 0, 0, 0


def build_dataflash(path: Path) -> None:
    """A real log once whole, then its messages over and over without the formats, TimeUS rising."""
    from flysid.ingest.formats.dataflash.frames import Walker

    source = (LOGS / "dataflash" / "sitl_copter_49s.BIN").read_bytes()
    walker = Walker()
    messages, _ = walker.walk(memoryview(source), 0, len(source))
    items = walker.definitions.items
    last = int(messages.start[-1]) + items[int(messages.code[-1])].length
    names = np.array([item.name for item in items])[messages.code]
    keep = ~np.isin(names, ["FMT", "FMTU", "UNIT", "MULT", "PARM", "FILE"])
    ends = np.append(messages.start[1:], last)
    parts = [source[s:e] for s, e in zip(messages.start[keep].tolist(), ends[keep].tolist(), strict=True)]
    body = np.frombuffer(b"".join(parts), dtype=np.uint8).copy()
    starts = np.cumsum([0] + [len(p) for p in parts[:-1]])
    has_time = np.array([item.labels[:1] == ("TimeUS",) for item in items])[messages.code[keep]]
    fields = np.lib.stride_tricks.as_strided(body[3:], (len(body) - 10, 8), (1, 1))
    timed = starts[has_time]
    with path.open("wb") as out:
        out.write(source[:last])
        while out.tell() < TARGET_BYTES:
            times = fields[timed].view("<u8").reshape(-1) + 49_000_000
            fields[timed] = times.view(np.uint8).reshape(-1, 8)
            out.write(body.tobytes())


def copy_small(path: Path) -> None:
    """The 3 MB telemetry log as it is."""
    path.write_bytes((LOGS / "tlog" / "sitl_copter_500s.tlog").read_bytes())


def copy_small_dataflash(path: Path) -> None:
    """The 3 MB DataFlash log as it is."""
    path.write_bytes((LOGS / "dataflash" / "sitl_copter_49s.BIN").read_bytes())


CASES = (
    Case(
        "tlog, 150 MB, to Arrow tables",
        "large.tlog",
        build_tlog,
        f"{READERS}:flysid_tables",
        {
            "pymavlink recv_match, nothing kept": (f"{READERS}:pymavlink_loop", 20.0),
            "pymavlink to pandas": (f"{READERS}:pymavlink_pandas", 30.0),
        },
        needs="tlog/sitl_copter_500s.tlog",
    ),
    Case(
        "tlog, 150 MB, to parquet",
        "large.tlog",
        build_tlog,
        f"{READERS}:flysid_parquet",
        {},
        needs="tlog/sitl_copter_500s.tlog",
    ),
    Case(
        "tlog, 3 MB, cold start",
        "small.tlog",
        copy_small,
        f"{READERS}:flysid_tables",
        {"pymavlink recv_match, nothing kept": (f"{READERS}:pymavlink_loop", 3.0)},
        needs="tlog/sitl_copter_500s.tlog",
        cold=True,
    ),
    Case(
        "DataFlash, 150 MB, to Arrow tables",
        "large.bin",
        build_dataflash,
        f"{READERS}:flysid_tables",
        {"DFReader to pandas": (f"{READERS}:dfreader_pandas", 25.0)},
        needs="dataflash/sitl_copter_49s.BIN",
    ),
    Case(
        "DataFlash, 150 MB, to parquet",
        "large.bin",
        build_dataflash,
        f"{READERS}:flysid_parquet",
        {},
        needs="dataflash/sitl_copter_49s.BIN",
    ),
    Case(
        "DataFlash, 3 MB, cold start",
        "small.bin",
        copy_small_dataflash,
        f"{READERS}:flysid_tables",
        {"DFReader to pandas": (f"{READERS}:dfreader_pandas", 3.0)},
        needs="dataflash/sitl_copter_49s.BIN",
        cold=True,
    ),
)
