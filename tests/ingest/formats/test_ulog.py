"""ULog: bit for bit what pyulog reads, and what pyulog loses."""

from __future__ import annotations

import contextlib
import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flysid
from flysid.errors import FormatError
from flysid.flight import Flight
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.registry import FORMATS
from flysid.ingest.formats.ulog.data import far_ahead
from tests.samplelogs import ulog as sample

LOGS = Path(__file__).resolve().parents[4] / "shared" / "logs" / "ulog"
REAL = sorted(LOGS.glob("*.ulg"))
INTACT = [p for p in REAL if not p.name.startswith("corrupt")]
needs_logs = pytest.mark.skipif(not REAL, reason="no ../shared/logs/ulog here")


def read(raw: bytes, limits: Limits | None = None) -> Flight:
    return collect(memoryview(raw), "x.ulg", FORMATS["ulog"], limits or Limits())


def pyulog(source: str | bytes) -> Any:
    from pyulog import ULog

    with contextlib.redirect_stdout(io.StringIO()):
        return ULog(io.BytesIO(source) if isinstance(source, bytes) else source)


def elements(flight: Flight, stream: str) -> dict[str, np.ndarray[Any, Any]]:
    """Columns as pyulog names them: arrays element by element, text byte by byte."""
    table = flight[stream]
    found: dict[str, np.ndarray[Any, Any]] = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        kind = str(column.type)
        if kind.startswith("fixed_size_list"):
            width = column.type.list_size
            values = column.combine_chunks().flatten().to_numpy(zero_copy_only=False).reshape(-1, width)
            found.update({f"{name}[{k}]": values[:, k] for k in range(width)})
        elif kind == "string":
            raw = [v.encode() for v in column.to_pylist()]
            for k in range(max(map(len, raw), default=0)):
                found[f"{name}[{k}]"] = np.array([v[k] if k < len(v) else 0 for v in raw], dtype=np.int8)
        else:
            found[name] = column.to_numpy()
    return found


def assert_equals_pyulog(flight: Flight, peer: Any) -> None:
    seen = set()
    for item in peer.data_list:
        stream = item.name + (f"#{item.multi_id}" if item.multi_id else "")
        seen.add(stream)
        ours = elements(flight, stream)
        for name, values in item.data.items():
            if name in ours:
                mine = ours[name]
                same = values != 0 if mine.dtype == bool else values
                assert mine.dtype == same.dtype, (stream, name)
                assert mine.tobytes() == np.ascontiguousarray(same).tobytes(), (stream, name)
            else:  # the tail of a text field, all zeros
                assert not values.any(), (stream, name)
    extra = {"parameters", "messages", "dropouts", "info_multiple"}
    assert set(flight.streams) - extra == seen


@needs_logs
@pytest.mark.parametrize("path", INTACT, ids=lambda p: p.stem)
def test_real_logs_equal_pyulog_bit_for_bit(path: Path) -> None:
    flight = flysid.read(path)
    peer = pyulog(str(path))
    assert_equals_pyulog(flight, peer)
    assert not flight.damage.lossy, flight.damage
    assert flight.damage.dropouts.get("records", 0) == len(peer.dropouts)
    assert flight.damage.dropouts.get("ms", 0) == sum(d.duration for d in peer.dropouts)
    texts = flight["messages"]["text"].to_pylist()
    tagged = [m for group in peer.logged_messages_tagged.values() for m in group]
    assert sorted(texts) == sorted(m.message for m in [*peer.logged_messages, *tagged])
    rows = flight["parameters"].to_pylist()
    assert {r["name"]: r["value"] for r in rows if r["origin"] == "initial"} == peer.initial_parameters
    changed = [(r["name"], r["value"]) for r in rows if r["origin"] == "changed"]
    assert changed == [(name, value) for _, name, value in peer.changed_parameters]
    system = {r["name"]: r["value"] for r in rows if r["origin"] == "system default"}
    assert system == peer.get_default_parameters(0)
    assert flight.info["sys_name"] == "PX4"


@needs_logs
def test_a_record_of_the_wrong_size_is_named_and_the_rest_equals_pyulog() -> None:
    path = LOGS / "corrupt_actuator_armed_wrong_size.ulg"
    flight = flysid.read(path)
    assert_equals_pyulog(flight, pyulog(str(path)))
    assert [r.reason for r in flight.damage.regions] == ["record of actuator_armed has a wrong size"]


@needs_logs
def test_a_damaged_log_keeps_at_least_what_pyulog_keeps() -> None:
    path = LOGS / "corrupt_format_not_utf8.ulg"
    flight = flysid.read(path)
    peer = pyulog(str(path))
    assert flight.damage.lossy
    for item in peer.data_list:
        stream = item.name + (f"#{item.multi_id}" if item.multi_id else "")
        assert flight[stream].num_rows >= len(item.data["timestamp"]), stream
    assert flight.rows > sum(len(d.data["timestamp"]) for d in peer.data_list)


def test_the_sample_equals_pyulog_and_has_every_stream() -> None:
    flight = read(sample.build())
    assert_equals_pyulog(flight, pyulog(sample.build()))
    topic = flight["topic"]
    assert topic["arr"].to_pylist()[:2] == [[0, 1, 2], [1, 2, 3]]
    assert topic["label"].to_pylist()[3] == "row 3"
    assert topic["path[1].y"].to_pylist()[3] == 1.0
    assert topic["on"].to_pylist()[:2] == [True, False]
    assert topic["time_ns"].to_pylist()[1] == 2_010_000_000
    messages = flight["messages"].to_pylist()
    assert [(m["level"], m["tag"], m["text"]) for m in messages] == [(6, None, "take-off"), (4, 7, "café")]
    parameters = flight["parameters"].to_pylist()
    assert [(p["name"], p["origin"]) for p in parameters] == [
        ("MPC_XY_P", "initial"),
        ("SYS_AUTOSTART", "initial"),
        ("MPC_XY_P", "system default"),
        ("MPC_XY_P", "setup default"),
        ("MPC_XY_P", "changed"),
    ]
    assert parameters[-1]["time_ns"] == 2_300_002_000
    assert flight.damage.dropouts == {"records": 1, "ms": 25}
    assert flight.info["firmware"] == "1.13.0"
    assert flight["info_multiple"]["text"].to_pylist() == ["hello"]


def tail(*parts: bytes) -> bytes:
    """The sample's definitions and two subscriptions, then `parts`."""
    first = sample.HEAD + sample.definitions()
    return first + sample.subscribe(0, 0, "topic") + sample.subscribe(2, 0, "other") + b"".join(parts)


def others(start: int, count: int, number: int = 2) -> bytes:
    rows = range(start, start + count)
    return b"".join(sample.data(number, sample.other_payload(k, 2_000_000 + k * 10_000)) for k in rows)


def test_a_topic_subscribed_again_goes_on_in_its_table() -> None:
    raw = tail(others(0, 10), sample.subscribe(5, 0, "other"), others(10, 10, 5), others(20, 3))
    assert read(raw)["other"]["count"].to_pylist() == [-k for k in range(23)]


def test_a_topic_whose_format_changes_goes_on_under_another_key() -> None:
    changed = sample.record("F", b"other:uint64_t timestamp;float value;int32_t count;uint32_t more;")
    payload = struct.pack("<QfiI", 5_000_000, 0.5, 1, 2)
    flight = read(tail(others(0, 4), changed, sample.subscribe(5, 0, "other"), sample.data(5, payload)))
    assert flight["other"].num_rows == 4
    assert flight["other~2"]["more"].to_pylist() == [2]


def test_logs_share_no_layout_that_another_format_decides() -> None:
    """`topic` holds a `point`: the same words mean other bytes where `point` is another."""
    for kind, code in (("float", "f"), ("int16_t", "h"), ("float", "f")):
        formats = (
            f"point:{kind} x;",
            "topic:uint64_t timestamp;point p;",
            "other:uint64_t timestamp;point x;",
        )
        head = sample.HEAD + b"".join(sample.record("F", text.encode()) for text in formats)
        rows = [sample.data(0, struct.pack(f"<Q{code}", 1_000_000 + k, k)) for k in range(5)]
        flight = read(head + sample.subscribe(0, 0, "topic") + b"".join(rows))
        assert flight["topic"]["p.x"].to_pylist() == list(range(5))
        assert not flight.damage.lossy


def test_appended_data_are_read_as_sections_of_their_own() -> None:
    body = tail(others(0, 10), others(10, 1)[:-5])
    offsets = [len(body), len(body) + len(others(11, 4))]
    flags = bytes(8) + b"\1" + bytes(7) + struct.pack("<QQQ", *offsets, 0)
    raw = bytearray(body + others(11, 4) + others(15, 4))
    raw[len(sample.HEAD) + 3 : len(sample.HEAD) + 43] = flags
    flight = read(bytes(raw))
    assert flight["other"]["count"].to_pylist() == [-k for k in [*range(10), *range(11, 19)]]
    assert flight.damage.truncated  # the log itself, before what was appended


def test_an_absurd_time_is_rejected_and_counted_and_old_ones_are_kept() -> None:
    absurd = sample.data(2, sample.other_payload(0, 2**60))
    minutes = sample.data(2, sample.other_payload(0, 4_000_000_000))
    old = sample.data(2, sample.other_payload(77, 5))
    flight = read(tail(others(0, 30), absurd, others(30, 5), minutes, old, others(35, 20)))
    assert flight.damage.time_outliers == {"other": 2}
    assert flight["other"].num_rows == 56
    assert flight.damage.out_of_order == {"other": 1}


def test_a_sample_kept_from_an_earlier_boot_gets_its_neighbours_time() -> None:
    retained = sample.data(0, sample.topic_payload(0, 900_000_000))
    flight = read(tail(others(0, 30), retained, others(30, 20)))
    assert flight["topic"]["timestamp"].to_pylist() == [900_000_000]
    assert flight["topic"]["time_ns"].to_pylist() == [2_300_000_000]
    assert flight.damage.out_of_order == {"topic": 1}
    assert not flight.damage.lossy


def test_a_gap_in_time_rejects_nothing() -> None:
    gap = b"".join(sample.data(2, sample.other_payload(k, 900_000_000 + k)) for k in range(40))
    flight = read(tail(others(0, 40), gap))
    assert flight.damage.time_outliers == {}
    assert flight["other"].num_rows == 80


def test_text_that_is_not_utf8_is_kept_with_replacements() -> None:
    message = sample.record("L", b"3" + struct.pack("<Q", 7) + b"\xff\xfe bad")
    assert read(tail(message, others(0, 3)))["messages"]["text"].to_pylist() == ["\ufffd\ufffd bad"]


def test_resynchronises_after_damage_without_losing_what_follows() -> None:
    raw = tail(others(0, 20), b"\x99" * 333, others(20, 20), sample.record("S", sample.SYNC), others(40, 5))
    flight = read(raw)
    assert flight["other"].num_rows == 45
    assert flight.damage.bytes_skipped == 333
    assert flight.damage.region_count == 1


@pytest.mark.parametrize("kind", "IMPQLCO")
@pytest.mark.parametrize("more", [100, 255, 1000])
def test_a_record_of_words_whose_size_is_wrong_swallows_nothing(kind: str, more: int) -> None:
    raw = sample.build()
    hit = [r for r in sample.records(raw)[1:] if raw[r.start + 2] == ord(kind)][-1]
    size = struct.pack("<H", hit.end - hit.start - 3 + more)
    flight = read(raw[: hit.start] + size + raw[hit.start + 2 :])
    assert flight.rows >= read(raw).rows - hit.rows
    assert flight.damage.lossy
    assert flight.damage.bytes_skipped == hit.end - hit.start


def test_an_id_that_two_subscriptions_claim_stays_with_the_one_whose_sizes_fit() -> None:
    raw = bytearray(sample.build())
    third = [r for r in sample.records(bytes(raw))[1:] if raw[r.start + 2] == ord("A")][2]
    raw[third.start + 4] = 0  # "other" says that it is number 0, which "topic" is
    flight = read(bytes(raw))
    assert flight["topic"].num_rows == 60
    assert flight.damage.undecoded == {"(subscriptions)": 1, "(message id 2)": 60}


@pytest.mark.parametrize(("kind", "at", "byte"), [("Q", 3, 0), ("M", 5, ord("g"))])
def test_words_of_no_known_kind_are_counted(kind: str, at: int, byte: int) -> None:
    raw = bytearray(sample.build())
    hit = next(r for r in sample.records(bytes(raw))[1:] if raw[r.start + 2] == ord(kind))
    raw[hit.start + at] = byte
    assert sum(read(bytes(raw)).damage.undecoded.values()) == 1


def test_subscriptions_are_found_behind_those_that_are_lost() -> None:
    raw = sample.build()
    first, second, third = (r for r in sample.records(raw)[1:] if raw[r.start + 2] == ord("A"))
    lost = raw[: second.start - 3] + b"\xff" * 8 + raw[second.start + 5 :]
    flight = read(lost)
    assert flight["other"].num_rows == 60
    assert flight.damage.regions[0].start == first.start
    assert flight.damage.regions[0].end == third.start
    assert sum(flight.damage.undecoded.values()) + flight.damage.bytes_skipped > 90


@pytest.mark.parametrize(
    "text",
    [
        "topic:topic a;",
        "topic:uint8_t[60000] a;uint8_t[60000] b;",
        "topic:missing[9999] a;",
        "topic:big[65535] a;",
        "topic:;",
        "topic:float",
        "topic:float[99999] x;",
    ],
)
def test_formats_without_a_layout_cost_only_their_topic(text: str) -> None:
    head = sample.HEAD + sample.record("F", sample.OTHER.encode()) + sample.record("F", b"big:point[999] p;")
    raw = head + sample.record("F", text.encode()) + sample.subscribe(2, 0, "other")
    raw += sample.subscribe(0, 0, "topic")
    raw += others(0, 5) + sample.data(0, bytes(20)) + others(5, 5) + sample.data(0, bytes(20)) + others(10, 5)
    flight = read(raw)
    assert flight["other"].num_rows == 15
    assert flight.damage.undecoded == {"topic": 2}


def test_not_a_ulog() -> None:
    for raw in (b"ULog", b"x" * 100):
        with pytest.raises(FormatError):
            read(raw)


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_behind_the_header(tail_bytes: bytes) -> None:
    read(sample.HEAD + tail_bytes)
    read(sample.build()[:400] + tail_bytes)


@given(st.lists(st.integers(0, 10**7), max_size=60), st.integers(0, 59))
def test_rising_times_are_never_ahead(steps: list[int], jump: int) -> None:
    times = np.cumsum(np.array(steps, dtype=np.int64))
    times[jump:] += 10**10
    late = far_ahead(times)
    assert not late[: max(0, len(times) - 5)].any()


def test_a_log_lasts_from_when_logging_began() -> None:
    """A log opens with older messages of topics: one of 76 s seemed to last four minutes."""
    raw = bytearray(sample.build())
    (whole,) = read(bytes(raw)).clocks
    assert whole.first_ns == 2_000_000_000
    for start_us, first_ns in ((2_200_000, 2_200_000_000), (10**15, whole.first_ns)):  # the other is damaged
        raw[8:16] = struct.pack("<Q", start_us)
        (clock,) = read(bytes(raw)).clocks
        assert (clock.first_ns, clock.last_ns) == (first_ns, whole.last_ns)
