"""ULog without positions and identifiers: fields overwritten where they stand.

ULog has no checksums. Bytes that are no record, data of unknown topics and record types that nobody knows are
left out; so are the offsets of appended data, whose sections then follow as one.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np

from flysid.ingest.formats.base import Limits
from flysid.ingest.formats.common import scrub_rules as rules
from flysid.ingest.formats.common.scrub_rules import Position, Scrubber, ScrubColumn
from flysid.ingest.formats.ulog.layouts import LayoutError, UlogLayout, flatten, parse_format
from flysid.ingest.formats.ulog.records import FILE_HEAD_BYTES, HEAD, HEAD_BYTES, Framer

CONTENT = frozenset({"gps_dump", "gps_inject_data", "rtcm", "satellite_info", "mavlink_log_dump"})
KEPT_INFO = ("ver_", "sys_name", "sys_os", "sys_mcu", "sys_toolchain", "metadata_", "time_ref")
PRIVATE_INFO = ("uuid", "serial", "replay", "owner", "operator", "name_user", "email", "wifi", "ssid", "uid")
COMMAND = "vehicle_command"


def scrub(view: memoryview, scrubber: Scrubber, limits: Limits) -> Iterator[bytes]:
    """The log's records, scrubbed."""
    return _Pass(view, scrubber, limits).pieces()


class _Pass:
    """One walk over the file."""

    def __init__(self, view: memoryview, scrubber: Scrubber, limits: Limits) -> None:
        self._view = view
        self._scrubber = scrubber
        self._limits = limits
        self._framer = Framer(view, len(view))
        self._formats: dict[str, str] = {}
        self._topics: list[tuple[str, UlogLayout]] = []

    def pieces(self) -> Iterator[bytes]:
        view = self._view
        framer = self._framer
        yield bytes(view[:FILE_HEAD_BYTES])
        at = FILE_HEAD_BYTES
        waiting = 0
        lost = 0
        batch: list[bytes] = []
        while at < framer.stop:
            run = framer.data_run(at) if framer.head(at)[0] == ord("D") else None
            if run is not None:
                end = framer.head(int(run.at[-1]))[2]
                batch.append(self._data(run.at, run.subscription, at, end))
            elif framer.is_sound(at):
                kind, body, end = framer.head(at)
                batch.append(self._other(kind, bytes(view[body:end])))
            else:
                end = framer.next_record(at + 1)
                lost += min(end, framer.stop) - at
            waiting = waiting + end - at
            at = end
            if waiting >= self._limits.batch_bytes:
                yield b"".join(batch)
                batch = []
                waiting = 0
        yield b"".join(batch)
        self._scrubber.note(rules.UNREADABLE, "between records", lost)

    def _data(self, at: np.ndarray, subscription: np.ndarray, start: int, end: int) -> bytes:
        """A run of data records."""
        out = np.frombuffer(self._view[start:end], dtype=np.uint8).copy()
        for number in np.unique(subscription).tolist():
            name, layout = self._topics[number]
            index = (at[subscription == number] - start + HEAD_BYTES + 2)[:, None] + np.arange(layout.size)
            rows = out[index].view(layout.dtype()).reshape(len(index))
            before = rows.tobytes()
            self._scrub_topic(rows, name, layout)
            if rows.tobytes() != before:
                out[index] = np.frombuffer(rows.tobytes(), dtype=np.uint8).reshape(index.shape)
        return out.tobytes()

    def _scrub_topic(self, rows: np.ndarray, name: str, layout: UlogLayout) -> None:
        scrubber = self._scrubber
        columns = {f.name: ScrubColumn(str(k), f.name) for k, f in enumerate(layout.fields)}
        plain = [c for f, c in zip(layout.fields, columns.values(), strict=True) if not f.count]
        rules.scrub_rows(rows, plain, name, scrubber)
        for field, column in zip(layout.fields, columns.values(), strict=True):
            if name in CONTENT and not field.name.startswith("timestamp"):
                rules.clear(rows, column.key, (rules.CONTENT, name), scrubber)
            elif field.kind == "char" and field.count:
                self._text_column(rows, column, field.count, name)
            elif field.count and rules.is_identity(field.name):
                rules.clear(rows, column.key, (rules.IDENTITY, f"{name}.{field.name}"), scrubber)
        if name == COMMAND and {"param5", "param6", "command"} <= set(columns):
            used = np.isin(rows[columns["command"].key], rules.LOCATED_COMMANDS)
            place = Position(columns["param5"], columns["param6"], ())
            rules.scrub_place(rows, place, name, scrubber, used)

    def _text_column(self, rows: np.ndarray, column: ScrubColumn, count: int, where: str) -> None:
        texts = [row.tobytes() for row in rows[column.key]]
        clean = [rules.redacted_field(text) for text in texts]
        changed = sum(a.rstrip(b"\0") != b.rstrip(b"\0") for a, b in zip(texts, clean, strict=True))
        self._scrubber.note(rules.TEXT, f"{where}.{column.name}", changed)
        rows[column.key] = np.frombuffer(b"".join(clean), dtype="i1").reshape(len(rows), count)

    # ----------------------------------------------------------------------- records other than data

    def _other(self, kind: int, body: bytes) -> bytes:
        """A sound record that is not data."""
        letter = chr(kind)
        if letter == "F":
            self._define(body)
        elif letter == "A":
            self._subscribe(body)
        elif letter == "R":
            self._framer.sizes.remove(body[0] | body[1] << 8)
            self._framer.changed()
        elif letter == "B":
            body = bytes(8) + bytes([body[8] & 0xFE]) + body[9:16] + bytes(len(body) - 16)
        elif letter in "IM":
            body = self._information(body, skip=1 if letter == "M" else 0)
        elif letter in "PQ":
            body = self._parameter(body, skip=1 if letter == "Q" else 0)
        elif letter in "LC":
            head = 9 if letter == "L" else 11
            clean = body[:head] + rules.redact(body[head:])
            self._scrubber.note(rules.TEXT, "messages", clean != body)
            body = clean
        return HEAD.pack(len(body), kind) + body

    def _define(self, body: bytes) -> None:
        try:
            name, fields = parse_format(body.decode("utf-8", "replace"))
        except LayoutError:
            return
        self._formats[name] = fields

    def _subscribe(self, body: bytes) -> None:
        number = struct.unpack("<H", body[1:3])[0]
        name = body[3:].decode("utf-8", "replace")
        sizes = self._framer.sizes
        try:
            layout = flatten(name, self._formats)
        except LayoutError:
            sizes.remove(number)
            sizes.known[number] = True
        else:
            self._topics.append((name, layout))
            sizes.subscribe(number, len(self._topics) - 1, layout.size, layout.full_size)
        self._framer.changed()

    def _information(self, body: bytes, skip: int) -> bytes:
        key, at = _key(body, skip)
        name = key.rpartition(" ")[2].lower()
        value = body[at:]
        if any(word in name for word in PRIVATE_INFO):
            clean = b"0" * len(value) if key.startswith("char[") else bytes(len(value))
            self._scrubber.note(rules.IDENTITY, f"information {name}", clean != value)
        else:
            clean = (
                rules.redact(value) if key.startswith("char[") and not name.startswith(KEPT_INFO) else value
            )
            self._scrubber.note(rules.TEXT, f"information {name}", clean != value)
        return body[:at] + clean

    def _parameter(self, body: bytes, skip: int) -> bytes:
        key, at = _key(body, skip)
        name = key.rpartition(" ")[2]
        if not rules.is_private_parameter(name):
            return body
        clean = body[:at] + bytes(len(body) - at)
        self._scrubber.note(rules.PARAMETER, f"parameters {name}", clean != body)
        return clean


def _key(body: bytes, skip: int) -> tuple[str, int]:
    """The key ("type name") of an information or parameter record, and where its value begins."""
    at = skip + 1 + body[skip]
    return body[skip + 1 : at].decode("utf-8", "replace"), at
