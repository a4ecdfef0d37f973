"""Logs of the Crazyflie's uSD card against a plain decoder of the published layout."""

from __future__ import annotations

import random
import struct
from typing import Any

import pytest

from flysid.flight import Flight, field_unit
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import all_formats, detect
from tests.samplelogs import crazyflie as sample


def read(blob: bytes) -> Flight:
    return collect(memoryview(blob), "log00.usd", all_formats()["crazyflie"], Limits(batch_bytes=4096))


def plain(blob: bytes) -> dict[str, list[tuple[Any, ...]]]:
    """(time ns, variables ...) of every event by the name of its kind, one `struct.unpack` at a time."""
    version, count = struct.unpack_from("<HH", blob, 1)
    at = 5
    kinds = {}
    for _ in range(count):
        (number,) = struct.unpack_from("<H", blob, at)
        end = blob.index(0, at + 2)
        name = blob[at + 2 : end].decode()
        (variables,) = struct.unpack_from("<H", blob, end + 1)
        at = end + 3
        code = "<"
        for _ in range(variables):
            end = blob.index(0, at)
            code += blob[end - 2 : end - 1].decode()
            at = end + 1
        kinds[number] = (name, code)
    head, unit = ("<HI", 1_000_000) if version == 1 else ("<HQ", 1_000)
    found: dict[str, list[tuple[Any, ...]]] = {}
    while at < len(blob) - 4:
        number, time = struct.unpack_from(head, blob, at)
        at += struct.calcsize(head)
        name, code = kinds[number]
        found.setdefault(name, []).append((time * unit, *struct.unpack_from(code, blob, at)))
        at += struct.calcsize(code)
    return found


@pytest.mark.parametrize("version", [1, 2])
def test_every_event_is_what_a_plain_decoder_reads(version: int) -> None:
    blob = sample.build(version)
    flight = read(blob)
    assert detect(blob[:4096], "log00").name == "crazyflie"
    assert not flight.damage.lossy
    expected = plain(blob)
    assert set(flight.streams) == set(expected)
    for name, rows in expected.items():
        table = flight.tables[name].drop_columns(["boot"])
        assert [tuple(row.values()) for row in table.to_pylist()] == rows


def test_units_are_those_that_the_firmware_documents() -> None:
    schema = read(sample.build())["fixedFrequency"].schema
    names = ("gyro.x", "stabilizer.roll", "motor.m1")
    assert [field_unit(schema.field(name)) for name in names] == ["deg/s", "deg", ""]


def test_nothing_is_invented_behind_damage() -> None:
    """Every row read from a damaged log stands in the sound one."""
    blob = sample.build()
    rng = random.Random(17)
    sound = {name: {row[0] for row in rows} for name, rows in plain(blob).items()}
    first = len(sample.header())
    for _ in range(150):
        at = rng.randrange(first, len(blob) - 100)
        size = rng.choice((1, 5, 29, 64))
        kind = rng.choice(("zeros", "noise", "gone"))
        middle = {"zeros": bytes(size), "noise": rng.randbytes(size), "gone": b""}[kind]
        damaged = blob[:at] + middle + blob[at + size :]
        flight = read(damaged)
        assert flight.damage.lossy == (damaged != blob)
        for name, table in flight.tables.items():
            times = table["time_ns"].to_pylist()
            strange = [time for time in times if time not in sound[name]]
            assert len(strange) <= 1, (at, size, kind)  # an event whose own time was hit
        assert flight.rows >= 504 - 8


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("event", [0, 1, -2, -1])
def test_a_bit_of_the_head_of_an_event_at_an_end_costs_no_other(version: int, event: int) -> None:
    blob = sample.build(version)
    events = sample.events(version)
    index = event % len(events)
    start = len(sample.header(version)) + sum(map(len, events[:index]))
    for bit in range(8 * (6 if version == 1 else 10)):  # of its head: kind and time
        damaged = bytearray(blob)
        damaged[start + bit // 8] ^= 1 << bit % 8
        flight = read(bytes(damaged))
        assert len(events) - 1 <= flight.rows <= len(events), bit
        assert flight.damage.lossy


def test_bytes_that_look_like_events_far_ahead_cost_only_themselves() -> None:
    """A time without its last byte, and a kind of 0 behind it, look like an event an hour ahead."""
    blob = bytearray(sample.build())
    blob[1767:1775] = (1).to_bytes(8, "little")
    flight = read(bytes(blob))
    assert flight.rows >= 502
    assert flight.clocks[0].last_ns < 20 * 10**9
