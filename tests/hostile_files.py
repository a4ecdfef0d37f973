"""Files that strangers could leave in a folder of logs, by kind: what is in them, or what they are on disk.

`lay(kind, folder, chance)` puts one there; two of a kind differ by what `chance` draws. `CONTENTS` are bytes,
which any place can hold; `ON_DISK` are things of the file system.
"""

from __future__ import annotations

import gzip
import io
import os
import random
import socket
import sqlite3
import struct
import tempfile
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import zstandard

from tests.format_trials import FORMATS, module_of, sample
from tests.samplelogs import mcap

Draw = random.Random
TABLE = b"time_s,x\n0,1\n1,2\n2,3\n"

# ---------------------------------------------------------------------------------------------- archives


def _member(name: bytes, body: bytes, **wrong: int) -> tuple[bytes, Callable[[int], bytes]]:
    """A stored member, and its entry in the list once its place is known; `wrong` replaces what is true."""
    fact = {
        "flags": 0,
        "method": 0,
        "crc": zlib.crc32(body),
        "packed": len(body),
        "size": len(body),
        "moved": 0,
        "extra": 0,
    } | wrong
    shared = (fact["flags"], fact["method"], 0, 0, fact["crc"], fact["packed"], fact["size"])
    head = struct.pack("<4s5H3I2H", b"PK\3\4", 20, *shared, len(name) & 0xFFFF, 0)

    def entry(at: int) -> bytes:
        ends = (len(name) & 0xFFFF, fact["extra"], 0, 0, 0, 0, (at + fact["moved"]) & 0xFFFFFFFF)
        return struct.pack("<4s6H3I5H2I", b"PK\1\2", 20, 20, *shared, *ends) + name

    return head + name + body, entry


def archive(*members: tuple[bytes, Callable[[int], bytes]], count: int | None = None, **wrong: int) -> bytes:
    """A .zip archive of members as `_member` makes them; `count` is what its end states."""
    blob = b""
    entries = b""
    for data, entry in members:
        entries += entry(len(blob))
        blob += data
    stated = len(members) if count is None else count
    size = wrong.get("size", len(entries))
    place = wrong.get("place", len(blob))
    return blob + entries + struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, stated, stated, size, place, 0)


def named(name: bytes, **wrong: int) -> bytes:
    """An archive of two members; the second is sound."""
    return archive(_member(name, TABLE, **wrong), _member(b"sound.csv", TABLE + b"3,9\n"))


def _with_name(name: bytes) -> Callable[[Draw], bytes]:
    return lambda draw: named(name, flags=draw.choice((0, 1 << 11)))


def _deep(levels: int) -> bytes:
    blob = TABLE
    for level in range(levels):
        blob = archive(_member(b"deeper.zip" if level else b"a.csv", blob))
    return blob


def _zip64(draw: Draw) -> bytes:
    """Sizes that stand in an extra field which lies, or which is not there."""
    name = b"a.tlog"
    extra = struct.pack("<HHQQQ", 1, 24, draw.getrandbits(63), draw.getrandbits(63), draw.getrandbits(63))
    extra = extra[: draw.randrange(len(extra) + 1)]
    head = struct.pack("<4s5H3I2H", b"PK\3\4", 45, 0, 0, 0, 0, 0, 2**32 - 1, 2**32 - 1, len(name), len(extra))
    ends = (len(name), len(extra), 0, 0, 0, 0, 2**32 - 1)
    entry = struct.pack("<4s6H3I5H2I", b"PK\1\2", 45, 45, 0, 0, 0, 0, 0, 2**32 - 1, 2**32 - 1, *ends)
    blob = head + name + extra + TABLE
    listed = entry + name + extra
    return blob + listed + struct.pack("<4s4H2IH", b"PK\5\6", 0, 0, 1, 1, len(listed), len(blob), 0)


def _archives() -> Mapping[str, Callable[[Draw], bytes]]:
    names = {
        "empty name": b"",
        "slash": b"/",
        "absolute": b"/etc/passwd.csv",
        "dots": b"../../../up.csv",
        "backslashes": b"..\\..\\up.csv",
        "drive": b"C:\\logs\\a.csv",
        "nul": b"a\0b.csv",
        "newline": b"a\nskipped: b.csv",
        "escape": b"\x1b[2J\x1b[31m.csv",
        "surrogate": b"\xed\xa0\x80.csv",
        "undecodable": b"\xff\xfe\xfd.csv",
        "right to left": "\u202evsc.exe.csv".encode(),
        "very long": b"n" * 5000 + b".csv",
        "longest": b"m/" * 32000 + b".csv",
        "of blanks": b"   ",
        "dot": b".",
        "hidden": b".hidden/.a.csv",
    }
    made: dict[str, Callable[[Draw], bytes]] = {
        f"zip, name {kind}": _with_name(name) for kind, name in names.items()
    }
    return made | {
        "zip, a name twice": lambda _: archive(*[_member(b"a.csv", TABLE)] * 9),
        "zip, a folder and a file of one name": lambda _: archive(
            _member(b"a.csv/", b""), _member(b"a.csv", TABLE), _member(b"a.csv/b.csv", TABLE)
        ),
        "zip, huge count": lambda draw: archive(_member(b"a.csv", TABLE), count=draw.randrange(2, 65535)),
        "zip, encrypted": lambda _: named(b"a.csv", flags=1),
        "zip, unknown method": lambda draw: named(b"a.csv", method=draw.randrange(1, 65536)),
        "zip, wrong checksum": lambda draw: named(b"a.csv", crc=draw.getrandbits(32)),
        "zip, wrong size": lambda draw: named(b"a.csv", size=draw.getrandbits(32)),
        "zip, wrong packed size": lambda draw: named(b"a.csv", packed=draw.getrandbits(32)),
        "zip, moved": lambda draw: named(b"a.csv", moved=draw.getrandbits(32)),
        "zip, extra": lambda draw: named(b"a.csv", extra=draw.randrange(1, 65536)),
        "zip, list elsewhere": lambda draw: archive(_member(b"a.csv", TABLE), place=draw.getrandbits(32)),
        "zip, list of another size": lambda draw: archive(
            _member(b"a.csv", TABLE), size=draw.getrandbits(32)
        ),
        "zip64": _zip64,
        "zip in zip": lambda draw: _deep(draw.randrange(2, 40)),
        "zip, empty": lambda _: archive(),
        "zip, cut": lambda draw: (blob := named(b"a.csv"))[: draw.randrange(5, len(blob))],
        "zip, damaged": lambda draw: flipped(named(b"a.csv"), draw),
    }


# ------------------------------------------------------------------------------------------------ packed


def _zeros(packer: Callable[[bytes], bytes], megabytes: int) -> bytes:
    return packer(TABLE + bytes(megabytes << 20))


PACKED: Mapping[str, Callable[[Draw], bytes]] = {
    "csv.gz, bomb": lambda draw: _zeros(gzip.compress, draw.randrange(300, 400)),
    "csv.zst, bomb": lambda draw: _zeros(zstandard.compress, draw.randrange(300, 400)),
    "csv.gz, cut": lambda draw: (blob := gzip.compress(TABLE * 99))[: draw.randrange(1, len(blob))],
    "csv.zst, cut": lambda draw: (blob := zstandard.compress(TABLE * 99))[: draw.randrange(1, len(blob))],
    "csv.gz, damaged": lambda draw: flipped(gzip.compress(TABLE * 99), draw),
    "csv.zst, damaged": lambda draw: flipped(zstandard.compress(TABLE * 99), draw),
    "csv.gz, many times": lambda _: gzip.compress(gzip.compress(gzip.compress(TABLE))),
    "csv.gz, and more": lambda draw: gzip.compress(TABLE) + draw.randbytes(300),
    "csv.zst, huge window": lambda draw: b"\x28\xb5\x2f\xfd\x00\xff" + draw.randbytes(60),
    "tlog.zst, a zip": lambda _: zstandard.compress(named(b"")),
}

# --------------------------------------------------------------------------------------- tables of Parquet


def parquet(columns: list[pa.Array], names: list[str], **options: object) -> bytes:
    """A file of these columns."""
    sink = io.BytesIO()
    pq.write_table(pa.Table.from_arrays(columns, names), sink, **options)
    return sink.getvalue()


_TIMES = pa.array([0.0, 1.0, 2.0, 3.0])


def _pair(draw: Draw, *names: str) -> bytes:
    return parquet(
        [_TIMES, *[pa.array([draw.random() for _ in range(4)]) for _ in names]], ["time_s", *names]
    )


def parquet_twice() -> bytes:
    """Two columns of one name, and a struct with two fields of one name."""
    struct_of = pa.StructArray.from_arrays([pa.array([7, 8, 9]), pa.array([10, 11, 12])], ["a", "a"])
    values = [pa.array([1.0, 2.0, 3.0]), pa.array([4.0, 5.0, 6.0])]
    return parquet([pa.array([0.0, 1.0, 2.0]), *values, struct_of], ["time_s", "x", "x", "s"])


def _of_footer(draw: Draw) -> bytes:
    """The footer alone is damaged: counts, places, types."""
    blob = bytearray(_pair(draw, "x", "y"))
    size = int.from_bytes(blob[-8:-4], "little")
    for _ in range(draw.randrange(1, 4)):
        blob[len(blob) - 8 - draw.randrange(1, size)] ^= draw.randrange(1, 256)
    return bytes(blob)


def _schema_lies(draw: Draw) -> bytes:
    table = pa.table({"time_s": _TIMES, "x": _TIMES})
    sink = io.BytesIO()
    said = {b"pandas": draw.choice((b"{", b"[]", b'{"index_columns": [{"start": 1e400}]}', b"\xff"))}
    with pq.ParquetWriter(sink, table.schema.with_metadata(said)) as writer:
        writer.write_table(table)
    return (
        sink.getvalue().replace(b"ARROW:schema", b"ARROW:schemb") if draw.random() < 0.5 else sink.getvalue()
    )


_NESTED = (
    pa.array([{"a": {"b": [1, 2]}}] * 4),
    pa.array([[("k", 1)]] * 4, pa.map_(pa.string(), pa.int32())),
    pa.array([[{"a": 1}]] * 4),
    pa.array([[[1], []]] * 4),
    pa.array([{}] * 4, pa.struct([])),
    pa.nulls(4),
    pa.array([b"12"] * 4, pa.binary(2)),
    pa.array([1] * 4, pa.decimal256(70, 3)),
    pa.array([1] * 4, pa.time64("us")),
    pa.array([2**62] * 4, pa.timestamp("s")),
    pa.array([-(2**63)] * 4, pa.duration("ns")),
    pa.array([2**31 - 1] * 4, pa.date32()),
)

PARQUET: Mapping[str, Callable[[Draw], bytes]] = {
    "parquet, a column twice": lambda draw: _pair(draw, "x", "x"),
    "parquet, the time twice": lambda draw: _pair(draw, "time_s", "x"),
    "parquet, our own names": lambda draw: _pair(draw, "time_ns", "boot", "time_ns"),
    "parquet, names without letters": lambda draw: _pair(draw, "", " ", "\n", "a\0b", "."),
    "parquet, no columns": lambda _: parquet([], []),
    "parquet, no rows": lambda _: parquet([pa.array([], pa.float64())], ["time_s"]),
    "parquet, nested": lambda draw: parquet([_TIMES, draw.choice(_NESTED)], ["time_s", "x"]),
    "parquet, huge dictionary": lambda draw: parquet(
        [pa.array(range(4000)), pa.array(["w" * draw.randrange(20000, 60000)] * 4000)],
        ["time_s", "text"],
        compression="zstd",
    ),
    "parquet, wide": lambda _: parquet([_TIMES] * 3000, [f"x{k}" for k in range(3000)]),
    "parquet, footer": _of_footer,
    "parquet, its schema": _schema_lies,
    "parquet, damaged": lambda draw: flipped(_pair(draw, "x"), draw),
    "parquet, cut": lambda draw: (blob := _pair(draw, "x"))[: draw.randrange(4, len(blob))],
    "parquet, footer alone": lambda draw: b"PAR1" + draw.randbytes(40) + struct.pack("<I", 2**31) + b"PAR1",
}

# --------------------------------------------------------------------------------------------- databases


def database(script: str) -> bytes:
    """What SQLite makes of these statements."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.db3")
        link = sqlite3.connect(path)
        link.executescript(script)
        link.close()
        return path.read_bytes()


_TOPIC = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
_MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
_SCHEMAS = (
    _MESSAGES,
    _TOPIC + _MESSAGES + "INSERT INTO messages VALUES (1, NULL, NULL, NULL), (2, 'a', 'b', 'c');",
    _TOPIC + "CREATE TABLE messages(a); INSERT INTO messages VALUES (1);",
    _TOPIC + "CREATE VIEW messages AS SELECT * FROM topics;",
    _TOPIC + "CREATE TABLE messages(id TEXT PRIMARY KEY, topic_id, timestamp, data) WITHOUT ROWID;",
    'CREATE TABLE messages("a,b)" CHECK ("a,b)" IN (1,2)), topic_id, timestamp, data);',
    _TOPIC + _MESSAGES + "INSERT INTO topics VALUES (1, '/a', 'no/such/Type', 'cdr');"
    "INSERT INTO messages VALUES (1, 1, 9223372036854775807, x'00'), (2, 1, -9223372036854775808, x'');",
    _TOPIC + _MESSAGES + "INSERT INTO topics VALUES (1, NULL, x'ff', 7), (2, '', '', '');"
    "INSERT INTO messages VALUES (1, 2, 0, zeroblob(70000));",
    "PRAGMA encoding='UTF-16le';" + _TOPIC + _MESSAGES,
    "CREATE TABLE t(a); CREATE TRIGGER messages AFTER INSERT ON t BEGIN SELECT 1; END;",
)

DATABASES: Mapping[str, Callable[[Draw], bytes]] = {
    "db3, odd schema": lambda draw: database(draw.choice(_SCHEMAS)),
    "db3, page that leads to itself": lambda draw: (
        sample("rosbag2")[:512]
        + b"".join(
            b"\5" + bytes(7) + struct.pack(">I", draw.randrange(1, 99)) + bytes(500) for _ in range(98)
        )
    ),
    "db3, size of page": lambda draw: (blob := sample("rosbag2"))[:16] + draw.randbytes(2) + blob[18:],
    "db3, first page": lambda draw: flipped(sample("rosbag2")[:512], draw) + sample("rosbag2")[512:],
}

# ------------------------------------------------------------------------------------------ tables, MCAP


def _summary(draw: Draw) -> bytes:
    """An MCAP file whose last record leads anywhere."""
    blob = bytearray(sample("mcap"))
    at = len(blob) - 8 - 20
    blob[at : at + 16] = draw.randbytes(16) if draw.random() < 0.5 else struct.pack("<QQ", at, 1 << 63)
    return bytes(blob)


TEXTS: Mapping[str, Callable[[Draw], bytes]] = {
    "csv, binary": lambda draw: b"time_s,x\n" + draw.randbytes(5000),
    "csv, head alone": lambda _: b"time_s,x,y,z\n",
    "csv, a column twice": lambda _: b"time_s,x,x,time_s\n" + b"0,1,2,0\n1,2,3,1\n2,3,4,2\n",
    "csv, control characters in its head": lambda draw: (
        b"time_s,\x1b[2J%c,\0\n1,2,3\n2,3,4\n" % draw.randrange(32)
    ),
    "csv, one endless line": lambda _: b"time_s," + b"x," * 300_000,
    "csv, open quote": lambda _: b'time_s,x\n0,"' + TABLE * 999,
    "csv, not numbers": lambda _: b"time_s,x\n" + b"nan,inf\n1e999,-1e999\n,,,\n" * 9,
    "csv, no text": lambda draw: draw.randbytes(3000).replace(b"\n", b""),
    "mcap, summary": _summary,
    "mcap, endless record": lambda draw: sample("mcap")[:8] + mcap.record(draw.randrange(256), b"", 2**63),
    "mcap, anything": lambda draw: sample("mcap")[:8] + draw.randbytes(4000),
}

# ------------------------------------------------------------------------------------------- every format


def flipped(blob: bytes, draw: Draw) -> bytes:
    """A few bytes are others."""
    out = bytearray(blob)
    for _ in range(draw.randrange(1, 9)):
        out[draw.randrange(len(out))] = draw.randrange(256)
    return bytes(out)


def _mutant(kind: str, draw: Draw) -> bytes:
    """A sample log with a stretch replaced, removed, repeated or drawn."""
    blob = sample(kind)
    first, last = sorted(draw.randrange(len(blob)) for _ in range(2))
    middle = draw.choice((b"", b"\xff" * 99, draw.randbytes(99), blob[first:last] * 2, bytes(5000)))
    return flipped(blob[:first] + middle + blob[last:], draw)


def _mutants() -> Mapping[str, Callable[[Draw], bytes]]:
    return {f"{module_of(kind).SUFFIX[1:]}, {kind}": partial(_mutant, kind) for kind in FORMATS}


def contents() -> Mapping[str, Callable[[Draw], bytes]]:
    """Every kind of hostile content; its first word is how a file of it is called."""
    return {**_archives(), **PACKED, **PARQUET, **DATABASES, **TEXTS, **_mutants()}


# ------------------------------------------------------------------------------------------- on the disk


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as link:
        place = Path.cwd()
        os.chdir(path.parent)  # an address has 107 bytes at most
        try:
            link.bind(path.name)
        finally:
            os.chdir(place)


def _unreadable(path: Path) -> None:
    """Whoever opens it may, and cannot read it; a superuser neither."""
    path.symlink_to("/proc/self/mem")


def _folder(path: Path) -> None:
    path.mkdir()
    (path / "notes.md").write_text("no log")


def _many_links(path: Path) -> None:
    path.mkdir()
    (path / "in.csv").symlink_to(path)
    (path / "up").symlink_to("..")


ON_DISK: Mapping[str, Callable[[Path], object]] = {
    "pipe.tlog": os.mkfifo,
    "pipe without a name": os.mkfifo,
    "loop.bin": lambda path: path.symlink_to(path),
    "loop": lambda path: path.symlink_to(path),
    "nowhere.ulg": lambda path: path.symlink_to("/nowhere/at/all"),
    "null.bin": lambda path: path.symlink_to("/dev/null"),
    "endless.csv": lambda path: path.symlink_to("/dev/zero"),
    "unreadable.tlog": _unreadable,
    "unreadable": _unreadable,
    "folder.tlog": _folder,
    "folder.zip": _folder,
    "links.csv": _many_links,
    "socket.bin": _socket,
    "empty.mcap": Path.touch,
    "empty": Path.touch,
    "zeros": lambda path: path.write_bytes(bytes(70_000)),
    "new\nline.csv": lambda path: path.write_bytes(TABLE),
    "\x1b[2J.csv": lambda path: path.write_bytes(TABLE),
    os.fsdecode(b"\xff\xfe.csv"): lambda path: path.write_bytes(TABLE),
    os.fsdecode(b"\xff\xfe.zip"): lambda path: path.write_bytes(named(b"")),
    "-rf.csv": lambda path: path.write_bytes(TABLE),
    "n" * 251 + ".csv": lambda path: path.write_bytes(TABLE),
    "=cmd|x!A1.csv": lambda path: path.write_bytes(TABLE),
}


def suffix_of(kind: str) -> str:
    """What a file of a kind of content ends in."""
    return "." + kind.partition(",")[0].partition(" ")[0].replace("zip64", "zip")


def kinds() -> list[str]:
    """Every kind of hostile file."""
    return [*contents(), *ON_DISK]


def lay(kind: str, folder: Path, draw: Draw) -> Path:
    """Put a hostile file of a kind into a folder."""
    if kind in ON_DISK:
        path = folder / kind
        ON_DISK[kind](path)
    else:
        path = folder / f"hostile{suffix_of(kind)}"
        path.write_bytes(contents()[kind](draw))
    return path
