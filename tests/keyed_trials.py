"""Logs whose messages belong to several things, drawn by a seed: no row is lost, invented or mixed.

A seed draws a kind of log, its messages, the fields that tell their things apart, and rows in random order.
Every thing must come back as a stream of its own with its rows in order, bit for bit. The message's bare
name must be refused with the list of its things, or mean the only one.
"""

from __future__ import annotations

import io
import json
import random
import string
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from flysid.errors import FlysidError, UsageError
from flysid.flight import Flight, message_of, stem_of
from flysid.ingest.align.quick import find_field
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.common.px4_keys import KEYS_IF_SEVERAL
from flysid.ingest.formats.keyed import thing_name
from flysid.ingest.formats.mavlink.dialect import KEYS
from flysid.ingest.formats.registry import find_format
from soak import Outcome
from tests.parameter_trials import written
from tests.samplelogs import dataflash, ulog

Row = dict[str, Any]
LETTERS = string.ascii_uppercase
WORDS = ("alt_err", "a.b", "x/y", "m,n", "q[0]", "Ü", "", "roll rate", "[", "1", "0")
INSTANCE_LABELS = ("I", "Instance", "Inst", "C")
"""What ArduPilot calls the byte behind the time that tells instances apart."""
WHOLE = {"b": (-128, 127), "B": (0, 255), "h": (-32768, 32767), "H": (0, 65535), "i": (-9, 9), "I": (0, 9)}
STEP_US = 5000
BATCHES = (1 << 12, 1 << 14, 8 << 20)


@dataclass
class Trial:
    """A log, and the rows of every stream that it must give; `batch_bytes` at a time are read."""

    seed: int
    format: str
    blob: bytes
    batch_bytes: int
    streams: dict[str, list[Row]] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        return sum(map(len, self.streams.values()))


def draw(seed: int) -> Trial:
    """The log that a seed draws."""
    rng = random.Random(seed)
    kind = rng.choice(tuple(KINDS))
    trial = Trial(seed, kind, b"", rng.choice(BATCHES))
    trial.blob = KINDS[kind](rng, trial.streams)
    return trial


def _keys(rng: random.Random, values: Callable[[], Any]) -> list[Any]:
    """One to five values of a key."""
    return [*dict.fromkeys(values() for _ in range(rng.randint(1, 5)))]


def _named(stem: str, texts: Sequence[object]) -> str:
    return f"{stem}[{thing_name([_text(text) for text in texts])}]" if texts else stem


def _plain_if_one(stem: str, things: dict[str, list[Row]]) -> dict[str, list[Row]]:
    """Streams of things that no definition tells apart: one alone keeps the plain name."""
    return things if len(things) > 1 else dict.fromkeys([stem], next(iter(things.values())))


def _single(rng: random.Random) -> float:
    """A number that a float of four bytes holds."""
    return float(np.float32(rng.uniform(-100, 100)))


# ------------------------------------------------------------------------------------------- DataFlash


@dataclass
class _Message:
    """A DataFlash message: its letters and labels, and the values that each of its keys takes."""

    name: str
    form: str
    labels: list[str]
    keys: dict[str, list[Any]]


def _dataflash(rng: random.Random, streams: dict[str, list[Row]]) -> bytes:
    messages = {
        20 + k: _draw_message(rng, f"{LETTERS[k]}{rng.choice(LETTERS)}") for k in range(rng.randint(1, 5))
    }
    head = (128, 129, 130, 131)
    types = {n: dataflash.TYPES[n] for n in head}
    types |= {n: (m.name, m.form, ",".join(m.labels)) for n, m in messages.items()}
    blob = [dataflash.fmt(n, types) for n in types]
    blob.append(dataflash.pack(129, 1, ord("#"), "instance", types=types))
    for number, message in messages.items():
        units = "".join(
            "s" if k == 0 else "#" if n in message.keys else "-" for k, n in enumerate(message.labels)
        )
        if message.labels[1] not in INSTANCE_LABELS or rng.random() < 0.5:
            blob.append(dataflash.pack(130, 1, number, units, "-" * len(units), types=types))
    for k in range(rng.randint(5, 300)):
        number = rng.choice(tuple(messages))
        message = messages[number]
        row: Row = {"TimeUS": 10_000_000 + STEP_US * k}
        for label, letter in zip(message.labels[1:], message.form[1:], strict=True):
            row[label] = rng.choice(message.keys[label]) if label in message.keys else _value(rng, letter)
        streams.setdefault(_named(message.name, [row[n] for n in message.keys]), []).append(row)
        blob.append(dataflash.pack(number, *row.values(), types=types))
    return b"".join(blob)


def _draw_message(rng: random.Random, name: str) -> _Message:
    """With no, one or two keys; half of those with one as ArduPilot lays them out."""
    count = rng.choice((0, 1, 1, 1, 2))
    plain = [(f"F{k}", rng.choice("fdhi")) for k in range(rng.randint(1, 5))]
    if count == 1 and rng.random() < 0.5:
        keyed = [(rng.choice(INSTANCE_LABELS), "B")]
        fields = keyed + plain
    else:
        keyed = [(f"K{k}", rng.choice("bBhHiInf")) for k in range(count)]
        fields = keyed + plain
        rng.shuffle(fields)
    keys = {
        label: _keys(rng, partial(_value, rng, letter))
        for label, letter in fields
        if (label, letter) in keyed
    }
    return _Message(name, "Q" + "".join(c for _, c in fields), ["TimeUS", *(n for n, _ in fields)], keys)


def _value(rng: random.Random, letter: str) -> Any:
    if letter in WHOLE:
        return rng.randint(*WHOLE[letter])
    if letter == "n":
        return "".join(rng.choice("abc.,%") for _ in range(rng.randint(0, 4)))
    return _single(rng) if letter == "f" else rng.uniform(-1e6, 1e6)


# --------------------------------------------------------------------------------------------- MAVLink


def _keyed_messages() -> list[Any]:
    """MAVLink's messages that have a key."""
    every = mavlink.mavlink_map.values()
    return [m for m in every if m.instance_field or KEYS.get(m.msgname) in m.fieldnames]


def _tlog(rng: random.Random, streams: dict[str, list[Row]]) -> bytes:
    senders = [(rng.randint(1, 9), rng.choice((1, 154))) for _ in range(rng.randint(1, 2))]
    kinds = rng.sample(_keyed_messages(), rng.randint(1, 5))
    keys = {kind.msgname: _keys(rng, partial(_field, rng, kind, _key_of(kind))) for kind in kinds}
    told: list[tuple[tuple[int, int], Any]] = []
    for k in range(rng.randint(5, 200)):
        kind = rng.choice(kinds)
        row = {name: _field(rng, kind, name) for name in kind.fieldnames}
        row |= {name: 5000 + 20 * k for name in row if name == "time_boot_ms"}
        row |= {
            name: 5_000_000 + 20_000 * k for name in row if name in ("time_usec", "time_us", "time_boot_us")
        }
        row[_key_of(kind)] = rng.choice(keys[kind.msgname])
        sender = rng.choice(senders)
        sent = [v.encode()[: _size(kind, n)] if isinstance(v, str) else v for n, v in row.items()]
        told.append((sender, kind(*sent)))
        stem = f"{sender[0]}.{sender[1]}/{kind.msgname}"
        streams.setdefault(_named(stem, [row[_key_of(kind)]]), []).append(row)
    return written(told)


def _key_of(kind: Any) -> str:
    return str(kind.instance_field or KEYS[kind.msgname])


def _size(kind: Any, name: str) -> int:
    return int(dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))[name])


def _field(rng: random.Random, kind: Any, name: str) -> Any:
    """A value of a field of a message."""
    form = kind.fieldtypes[kind.fieldnames.index(name)]
    size = _size(kind, name)
    if form == "char":
        return _fitting(rng.choice(WORDS), max(size, 1))
    one = (lambda: _single(rng)) if form in ("float", "double") else (lambda: rng.randint(0, 100))
    return [one() for _ in range(size)] if size else one()


def _fitting(word: str, size: int) -> str:
    """As many whole characters as fit."""
    return word.encode()[:size].decode("utf-8", "ignore")


def _text(value: object) -> str:
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


# ------------------------------------------------------------------------------------------------ ULog

TOPICS: Mapping[str, tuple[str, str]] = {
    # topic: (its fields behind the time, its key)
    "debug_key_value": ("float value;char[10] key", "key"),
    "debug_vect": ("float x;float y;char[10] name", "name"),
    "debug_value": ("int8_t ind;float value", "ind"),
    "transponder_report": ("uint32_t icao_address;double lat", "icao_address"),
    "battery_status": ("float voltage_v;uint8_t id", "id"),
    "sensor_combined": ("float gyro;int32_t count", ""),
}
CODES = {
    "float": "f",
    "double": "d",
    "int8_t": "b",
    "uint8_t": "B",
    "uint32_t": "I",
    "int32_t": "i",
    "char[10]": "10s",
}


def _ulog(rng: random.Random, streams: dict[str, list[Row]]) -> bytes:
    names = rng.sample(tuple(TOPICS), rng.randint(1, 4))
    blob = [ulog.HEAD, ulog.record("B", bytes(40))]
    blob += [ulog.record("F", f"{n}:uint64_t timestamp;{TOPICS[n][0]};".encode()) for n in names]
    topics = [(n, instance) for n in names for instance in range(rng.randint(1, 2))]
    blob += [ulog.subscribe(k, instance, n) for k, (n, instance) in enumerate(topics)]
    keys = {
        k: _keys(rng, partial(_topic_value, rng, _kind_of(n, TOPICS[n][1])))
        for k, (n, _) in enumerate(topics)
        if TOPICS[n][1]
    }
    found: dict[tuple[str, bool], dict[str, list[Row]]] = {}
    for k in range(rng.randint(5, 200)):
        number = rng.randrange(len(topics))
        name, instance = topics[number]
        fields = [tuple(f.split(" ")) for f in TOPICS[name][0].split(";")]
        row: Row = {"timestamp": 1_000_000 + STEP_US * k}
        row |= {label: _topic_value(rng, kind) for kind, label in fields}
        key = TOPICS[name][1]
        if key:
            row[key] = rng.choice(keys[number])
        stem = f"{name}#{instance}" if instance else name
        things = found.setdefault((stem, name in KEYS_IF_SEVERAL), {})
        things.setdefault(_named(stem, [row[key]] if key else []), []).append(row)
        form = "<Q" + "".join(CODES[kind] for kind, _ in fields)
        blob.append(
            ulog.data(
                number, struct.pack(form, *(v.encode() if isinstance(v, str) else v for v in row.values()))
            )
        )
    for (stem, if_several), things in found.items():
        streams |= _plain_if_one(stem, things) if if_several else things
    return b"".join(blob)


def _kind_of(topic: str, label: str) -> str:
    return next(kind for kind, name in (f.split(" ") for f in TOPICS[topic][0].split(";")) if name == label)


def _topic_value(rng: random.Random, kind: str) -> Any:
    if kind == "char[10]":
        return _fitting(rng.choice(WORDS), 10)
    if kind in ("float", "double"):
        return _single(rng)
    return rng.randint(0, 100)


# ------------------------------------------------------------------------------------------------ MCAP


def _mcap(rng: random.Random, streams: dict[str, list[Row]]) -> bytes:
    """JSON topics whose messages name a frame of reference: apart where there are several."""
    target = io.BytesIO()
    writer = Writer(target, chunk_size=1 << rng.randint(9, 16), compression=CompressionType.NONE)
    writer.start(profile="", library="trial")
    properties = {"frame_id": {"type": "string"}, "value": {"type": "number"}, "count": {"type": "integer"}}
    schema = json.dumps({"type": "object", "properties": properties}).encode()
    topics = {}
    for k in range(rng.randint(1, 4)):
        schema_id = writer.register_schema(name=f"S{k}", encoding="jsonschema", data=schema)
        channel = writer.register_channel(topic=f"/t{k}", message_encoding="json", schema_id=schema_id)
        topics[f"/t{k}"] = (channel, _keys(rng, lambda: rng.choice(WORDS)))
    found: dict[str, dict[str, list[Row]]] = {}
    for k in range(rng.randint(5, 200)):
        topic = rng.choice(tuple(topics))
        channel, frames = topics[topic]
        row: Row = {"frame_id": rng.choice(frames), "value": _single(rng), "count": k}
        found.setdefault(topic, {}).setdefault(_named(topic, [row["frame_id"]]), []).append(row)
        at_ns = 1_700_000_000 * 10**9 + 10**7 * k
        writer.add_message(channel, at_ns, json.dumps(row).encode(), at_ns, sequence=k)
    writer.finish()  # type: ignore[no-untyped-call]
    for topic, things in found.items():
        streams |= _plain_if_one(topic, things)
    return target.getvalue()


KINDS: Mapping[str, Callable[[random.Random, dict[str, list[Row]]], bytes]] = {
    "dataflash": _dataflash,
    "tlog": _tlog,
    "ulog": _ulog,
    "mcap": _mcap,
}


# ---------------------------------------------------------------------------------------------- judging


def faults(trial: Trial) -> Iterator[str]:
    """What is lost, invented, mixed or misnamed."""
    limits = Limits(batch_bytes=trial.batch_bytes)
    flight = collect(memoryview(trial.blob), "t", find_format(trial.format), limits)
    own = {stem_of(name) for name in trial.streams}
    got = {key for key in flight.streams if stem_of(key) in own}
    if got != set(trial.streams):
        yield f"streams {sorted(got)}, not {sorted(trial.streams)}"
        return
    for name, rows in trial.streams.items():
        table = flight.tables[name]
        if table.num_rows != len(rows):
            yield f"{name}: {table.num_rows} rows, not {len(rows)}"
            continue
        for label in rows[0]:
            meant = [_plain(row[label]) for row in rows]
            if label in table.column_names and [_plain(v) for v in table[label].to_pylist()] != meant:
                yield f"{name}.{label}: other values"
    yield from _addresses(trial, flight)


def _plain(value: Any) -> Any:
    """Lists as tuples; single-precision numbers as Python's."""
    return tuple(value) if isinstance(value, list) else value


def _addresses(trial: Trial, flight: Flight) -> Iterator[str]:
    """The bare name of a message, and the fields of its things, as every verb resolves them."""
    for stem in {stem_of(name) for name in trial.streams}:
        things = sorted(name for name in trial.streams if stem_of(name) == stem)
        try:
            table = flight[stem]
        except UsageError as error:
            if len(things) == 1 or any(n not in (error.hint or "") for n in things[:9]):
                yield f"{stem} is refused: {error.advice}"
        else:
            if len(things) > 1 or table is not flight.tables[things[0]]:
                yield f"{stem} means one of {things}"
        label = next(n for n in trial.streams[things[0]][0] if n in flight.tables[things[0]].column_names)
        for name in things:
            try:
                place = find_field([FlightLog(flight)], f"{name}.{label}")
            except FlysidError as error:
                yield f"{name}.{label} is refused: {error.advice}"
            else:
                if place.stream != name:
                    yield f"{name}.{label} is that of {place.stream}, {message_of(name)}"


def _named_faults(trial: Trial) -> list[str]:
    """The faults with the log's format; an exception is one, too."""
    try:
        found = list(faults(trial))
    except Exception as error:  # noqa: BLE001 - this is what the trials look for
        found = [f"{type(error).__name__}: {error}"]
    return [f"{trial.format}: {fault}" for fault in found]


def trials(count: int, goes_on: Callable[[], bool], first_seed: int = 0) -> Outcome:
    """Draw and judge logs, one seed each."""
    outcome = Outcome("keyed logs")
    seeds = range(first_seed, first_seed + count)
    outcome.judge(seeds, goes_on, draw, _named_faults, lambda trial: trial.rows)
    return outcome
