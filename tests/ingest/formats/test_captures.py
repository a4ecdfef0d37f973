"""MAVLink inside captures: pcap and pcapng, UDP and TCP, told from navdata and other traffic by content."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flysid
from flysid.errors import FormatError, UsageError
from flysid.flight import Flight
from flysid.ingest.formats.base import Limits, collect
from flysid.ingest.formats.common.columns import as_array
from flysid.ingest.formats.mavlink.frames import STAMP_BYTES, read_header
from flysid.ingest.formats.mavlink.probing import make_scanner
from flysid.ingest.formats.registry import FORMATS, detect
from flysid.ingest.formats.scrubbing import scrub_log
from tests.format_trials import CARRIED, cut, delete, flip, insert, length
from tests.ingest.formats.test_tlog import LOGS, flying
from tests.samplelogs import navdata
from tests.samplelogs.tlog import frame, sender

START_NS = 1_700_000_000 * 10**9
VEHICLE = (b"\x0a\x00\x00\x01", 14550)
STATION = (b"\x0a\x00\x00\x02", 14550)
Packet = tuple[int, bytes]


def ip(protocol: int, source: bytes, target: bytes, body: bytes) -> bytes:
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(body), 1, 0, 64, protocol, 0)
    return b"\0" * 12 + b"\x08\x00" + head + source + target + body


def udp(content: bytes, source: tuple[bytes, int] = VEHICLE, target: tuple[bytes, int] = STATION) -> bytes:
    body = struct.pack(">4H", source[1], target[1], 8 + len(content), 0) + content
    return ip(17, source[0], target[0], body)


def tcp(content: bytes, number: int) -> bytes:
    body = struct.pack(">2H2IBBHHH", 5760, 40000, number % 2**32, 0, 0x50, 0x18, 1000, 0, 0) + content
    return ip(6, VEHICLE[0], STATION[0], body)


def over_ipv6(frame: bytes, extension: bytes = b"", kind: int | None = None) -> bytes:
    """The same packet over IPv6, behind an extension header of this kind."""
    body = frame[34:]
    hosts = b"".join(bytes(12) + host for host in (frame[26:30], frame[30:34]))
    first = frame[23] if kind is None else kind
    head = struct.pack(">IHBB", 6 << 28, len(extension) + len(body), first, 64)
    return frame[:12] + b"\x86\xdd" + head + hosts + extension + body


def fragments(frame: bytes, number: int, cut: int = 16) -> list[bytes]:
    """Both parts of a packet over IPv4."""
    parts = []
    for offset, body, more in ((0, frame[34:][:cut], 0x2000), (cut, frame[34:][cut:], 0)):
        head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(body), number, more | offset // 8, 64, 17, 0)
        parts.append(frame[:14] + head + frame[26:34] + body)
    return parts


def fragments_v6(frame: bytes, number: int, cut: int = 16) -> list[bytes]:
    parts = []
    for offset, body, more in ((0, frame[34:][:cut], 1), (cut, frame[34:][cut:], 0)):
        extension = struct.pack(">BBHI", 17, 0, offset | more, number)
        parts.append(over_ipv6(frame[:34] + body, extension, 44))
    return parts


def pcap(packets: list[Packet], link: int = 1) -> bytes:
    records = [
        struct.pack("<4I", t // 10**9, t % 10**9 // 1000, len(data), len(data)) + data for t, data in packets
    ]
    return struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link) + b"".join(records)


def block(kind: int, body: bytes, order: str) -> bytes:
    padded = body + bytes(-len(body) % 4)
    size = struct.pack(order + "I", 12 + len(padded))
    return struct.pack(order + "I", kind) + size + padded + size


def pcapng(packets: list[Packet], order: str = "<", nano: bool = True) -> bytes:
    resolution = struct.pack(order + "2HB3x", 9, 1, 9) + bytes(4) if nano else b""
    out = [block(0x0A0D0D0A, struct.pack(order + "I2Hq", 0x1A2B3C4D, 1, 0, -1), order)]
    out.append(block(1, struct.pack(order + "2HI", 1, 0, 65535) + resolution, order))
    out.append(block(5, bytes(12), order))  # statistics of the interface
    for time_ns, data in packets:
        ticks = time_ns if nano else time_ns // 1000
        head = struct.pack(order + "5I", 0, ticks >> 32, ticks & 0xFFFFFFFF, len(data), len(data))
        out.append(block(6, head + data, order))
    return b"".join(out)


def read(blob: bytes) -> Flight:
    return collect(memoryview(blob), "x.pcap", FORMATS["tlog"], Limits())


def over_udp(frames: list[bytes]) -> list[Packet]:
    """Two frames a datagram, among traffic of others."""
    noise = random.Random(1)
    packets = []
    for i in range(0, len(frames), 2):
        packets.append((START_NS + i * 20 * 10**6, udp(b"".join(frames[i : i + 2]))))
        other = (b"\x0a\x00\x00\x09", noise.randrange(1024, 60000))
        packets.append((START_NS + i * 20 * 10**6 + 1000, udp(noise.randbytes(40), other)))
    return packets


def over_tcp(frames: list[bytes]) -> list[Packet]:
    """The stream cut anywhere; a segment sent twice; numbers that wrap."""
    stream = b"".join(frames)
    at = 0
    packets = []
    rng = random.Random(2)
    first = 2**32 - 500
    while at < len(stream):
        size = rng.randrange(1, 90)
        segment = (START_NS + at * 10**6, tcp(stream[at : at + size], first + at))
        packets += [segment, segment] if rng.random() < 0.1 else [segment]
        at += size
    return packets


@pytest.mark.parametrize("pack", [pcap, pcapng, lambda p: pcapng(p, ">"), lambda p: pcapng(p, "<", False)])
@pytest.mark.parametrize("carry", [over_udp, over_tcp])
def test_frames_of_a_capture_are_those_of_the_vehicle(pack: object, carry: object, tmp_path: Path) -> None:
    frames = flying(sender(), 200)
    path = tmp_path / "flight"
    path.write_bytes(pack(carry(frames)))  # type: ignore[operator]
    flight = flysid.read(path)
    table = flight["ATTITUDE"]
    assert flight.source.format == "tlog"
    assert table["time_ns"].to_pylist() == [(1000 + 20 * i) * 10**6 for i in range(200)]
    assert table["recv_ns"].to_pylist()[0] == pytest.approx(START_NS, abs=10**9)
    assert flight.info["timestamps"] == "capture"
    assert not flight.damage.lossy
    assert flight.damage.sequence_gaps == {}


def compare_with_the_log(name: str) -> None:
    """A real log's frames, each sent over a network when it arrived, are read as the log is."""
    blob = (LOGS / f"{name}.tlog").read_bytes()
    scanner = make_scanner("ardupilotmega", STAMP_BYTES, len(blob))
    frames, _ = scanner.scan(as_array(blob), 0, len(blob))
    assert frames.stamp_us is not None
    ends = [head.end for at in frames.start.tolist() if (head := read_header(blob, at)) is not None]
    sent = [
        (int(us) * 1000, udp(blob[start:end]))
        for us, start, end in zip(frames.stamp_us, frames.start, ends, strict=True)
    ]
    log = collect(memoryview(blob), name, FORMATS["tlog"], Limits())
    for pack in (pcap, pcapng):
        flight = read(pack(sent))
        assert set(flight.streams) == set(log.streams)
        for stream, table in log.tables.items():
            other = flight.tables[stream]
            assert other.num_rows == table.num_rows, stream
            for column in set(table.column_names) - {"time_ns", "boot"}:
                left, right = (part[column].to_pylist() for part in (other, table))
                assert left == right or np.array_equal(left, right, equal_nan=True), (stream, column)


@pytest.mark.skipif(not LOGS.is_dir(), reason="no ../shared/logs/tlog")
def test_a_real_log_over_a_network_is_what_the_log_itself_says() -> None:
    compare_with_the_log("sitl_copter_98s")


def test_a_capture_of_navdata_stays_navdata_and_one_of_neither_is_refused() -> None:
    packets = over_udp(flying(sender(), 20))
    assert detect(pcap(packets), "a.pcap").name == "tlog"
    neither = pcap([(START_NS, udp(random.Random(3).randbytes(60))) for _ in range(50)])
    with pytest.raises(FormatError, match="a network capture without MAVLink or navdata"):
        detect(neither, "a.pcap")
    with pytest.raises(FormatError, match="no MAVLink in the capture"):
        read(neither)
    drone = udp(navdata.packet(1, {0: navdata.demo(1)}), (VEHICLE[0], 5554))
    assert detect(pcapng([(START_NS + i, drone) for i in range(9)]), "a.pcap").name == "navdata"


def test_damage_in_a_capture_is_counted_in_bytes_of_the_file() -> None:
    frames = flying(sender(), 60)
    packets = over_udp(frames)
    blob = bytearray(pcapng(packets))
    at = blob.index(frames[30])
    blob[at + 10] ^= 1
    flight = read(bytes(blob))
    assert (flight.rows, flight.damage.bad_checksums, flight.damage.bytes_skipped) == (59, 1, len(frames[30]))
    (region,) = flight.damage.regions
    assert (region.start, region.end) == (at, at + len(frames[30]))
    cut = read(bytes(blob[: len(blob) * 2 // 3]))
    assert cut.damage.truncated
    assert 35 <= cut.rows <= 41
    hole = bytes(blob[:at]) + bytes(50) + bytes(blob[at + 50 :])
    assert read(hole).rows >= 57


def test_a_damaged_datagram_ahead_of_all_sound_ones_is_counted() -> None:
    packets = over_udp(flying(sender(), 20))
    blob = bytearray(pcap(packets))
    at = blob.index(b"\xfd")  # of the first frame: as yet, nothing says that this flow is MAVLink
    blob[at + 12] ^= 1
    flight = read(bytes(blob))
    assert flight.rows < 20
    assert flight.damage.undecoded == {"datagrams": 1}


@pytest.mark.parametrize("byte", [1, 3, 6, 7, 9, 13, 17])
def test_a_damaged_ip_header_is_counted(byte: int) -> None:
    def summed(frame: bytes) -> bytes:
        total = sum(struct.unpack(">10H", frame[14:34])) % 0xFFFF
        return frame[:24] + struct.pack(">H", 0xFFFF - total) + frame[26:]

    packets = [(time_ns, summed(data)) for time_ns, data in over_udp(flying(sender(), 20))]
    assert not read(pcap(packets)).damage.lossy
    time_ns, data = packets[6]
    broken = bytearray(data)
    broken[14 + byte] ^= 4
    flight = read(pcap([*packets[:6], (time_ns, bytes(broken)), *packets[7:]]))
    assert flight.rows == 18
    assert flight.damage.undecoded == {"packets": 1}


def test_two_systems_on_two_flows_are_told_apart() -> None:
    one = sender()
    two = sender(2)
    packets = []
    for i, (first, second) in enumerate(zip(flying(one, 50), flying(two, 50), strict=True)):
        packets += [(START_NS + i * 10**7, udp(first)), (START_NS + i * 10**7, udp(second, STATION, VEHICLE))]
    heartbeat = frame(one, one.heartbeat_encode(2, 3, 0, 0, 4))
    flight = read(pcap([*packets, (START_NS + 10**9, udp(heartbeat))]))
    assert {s: t.num_rows for s, t in flight.tables.items()} == {
        "1.1/ATTITUDE": 50,
        "1.1/HEARTBEAT": 1,
        "2.1/ATTITUDE": 50,
    }


@pytest.mark.parametrize("carry", [over_udp, over_tcp])
@pytest.mark.parametrize("extension", [(b"", None), (b"{}" + bytes(6), 0), (b"{}" + bytes(6), 60)])
def test_ipv6_is_read_as_ipv4(
    carry: Callable[..., list[Packet]], extension: tuple[bytes, int | None]
) -> None:
    packets = []
    for time_ns, data in carry(flying(sender(), 100)):
        behind = extension[0].replace(b"{}", bytes([data[23], 0]))
        packets.append((time_ns, over_ipv6(data, behind, extension[1])))
    for blob in (pcap(packets), pcapng(packets), pcap([(t, p[14:]) for t, p in packets], 229)):
        assert detect(blob, "a.pcap").name == "tlog"
        flight = read(blob)
        assert flight["ATTITUDE"].num_rows == 100
        assert not flight.damage.lossy
        assert flight.damage.sequence_gaps == {}


@pytest.mark.parametrize("cut", [fragments, fragments_v6])
def test_fragments_are_put_together_and_one_that_is_missing_is_counted(
    cut: Callable[[bytes, int], list[bytes]],
) -> None:
    parts = []
    for number, one in enumerate(flying(sender(), 100), start=1):
        own = [(START_NS + number * 10**7, part) for part in cut(udp(one), number)]
        parts += own if number % 3 else own[::-1]
    assert read(pcap(parts)).rows == 100
    assert not read(pcap(parts)).damage.lossy
    flight = read(pcap([*parts[:43], *parts[44:]]))
    assert flight.rows == 99
    assert flight.damage.undecoded == {"datagrams": 1}


def test_segments_that_overtake_others_wait_for_them() -> None:
    packets = over_tcp(flying(sender(), 200))
    rng = random.Random(5)
    for i in range(2, len(packets) - 4, 5):  # the first tells where the stream begins
        mixed = packets[i : i + 4]
        rng.shuffle(mixed)
        packets[i : i + 4] = mixed
    flight = read(pcap(packets))
    assert flight.rows == 200
    assert flight.damage.sequence_gaps == {}
    assert not flight.damage.lossy


def test_a_segment_that_is_missing_costs_no_other_frames() -> None:
    frames = flying(sender(), 200)
    numbers = [100 + sum(map(len, frames[:i])) for i in range(200)]
    packets = [(START_NS + i * 10**7, tcp(frames[i], numbers[i])) for i in range(200) if i not in (50, 195)]
    flight = read(pcap(packets))
    assert flight["ATTITUDE"]["time_ns"].to_pylist() == [
        (1000 + 20 * i) * 10**6 for i in range(200) if i not in (50, 195)
    ]


def over_fragments(frames: list[bytes]) -> list[Packet]:
    """Each datagram of two frames in two fragments."""
    return [
        (time_ns, part)
        for number, (time_ns, data) in enumerate(over_udp(frames), start=1)
        for part in fragments(data, number)
    ]


@pytest.mark.parametrize("carry", [over_udp, over_tcp, over_fragments])
@pytest.mark.parametrize("pack", [pcap, pcapng])
def test_damaged_frames_lie_where_the_file_holds_them(
    carry: Callable[[list[bytes]], list[Packet]], pack: Callable[[list[Packet]], bytes]
) -> None:
    frames = flying(sender(), 40)
    lost = range(9, 15)  # neighbours, in three datagrams
    broken = [
        bytes([*one[:12], one[12] ^ 0x55, *one[13:]]) if i in lost else one for i, one in enumerate(frames)
    ]
    blob = pack(carry(broken))
    flight = read(blob)
    assert (flight.rows, flight.damage.bytes_skipped) == (34, sum(len(frames[i]) for i in lost))
    regions = flight.damage.regions
    assert flight.damage.region_count == len(regions) >= 3
    assert b"".join(blob[r.start : r.end] for r in regions) == b"".join(broken[i] for i in lost)


def test_a_hole_beside_damaged_frames_is_counted_once() -> None:
    packets = over_udp(flying(sender(), 60))
    blob = bytearray(pcap(packets))
    frame_size = len(flying(sender(), 1)[0])
    for at in (blob.index(packets[k][1]) + 42 for k in (20, 22, 24, 26)):
        blob[at + 12] ^= 1
        blob[at + frame_size + 12] ^= 1
    at = blob.index(packets[21][1])  # what others sent, between them
    blob[at - 16 : at + 20] = bytes(36)
    damage = read(bytes(blob)).damage
    assert damage.region_count == len(damage.regions)
    assert all(a.end <= b.start for a, b in zip(damage.regions, damage.regions[1:], strict=False))
    assert damage.bytes_skipped == sum(region.size for region in damage.regions)


def stream_of(frames: list[bytes], size: int, first: int = 1) -> list[Packet]:
    """The frames in segments of one size."""
    stream = b"".join(frames)
    return [
        (START_NS + at * 10**5, tcp(stream[at : at + size], first + at)) for at in range(0, len(stream), size)
    ]


@pytest.mark.parametrize("place", ["start", "middle", "end"])
def test_a_frame_of_which_a_stream_lacks_a_part_is_counted(place: str) -> None:
    frames = flying(sender(), 60)
    size = len(frames[0])
    packets = stream_of(frames, size - 7)
    where = {"start": 0, "middle": 33, "end": len(packets) - 1}[place]
    flight = read(pcap(packets[:where] + packets[where + 1 :]))
    gone = set(range(where * (size - 7), min((where + 1) * (size - 7), 60 * size)))
    cut = [i for i in range(60) if gone & set(range(i * size, (i + 1) * size))]
    assert flight.rows == 60 - len(cut)
    assert flight.damage.bytes_skipped == len(set(range(cut[0] * size, (cut[-1] + 1) * size)) - gone)


def test_frames_behind_garbage_in_a_stream_arrive_when_they_come() -> None:
    frames = flying(sender(), 60)
    stream = [*frames[:30], bytes(5 * len(frames[0])), *frames[30:]]
    sound, hurt = (
        read(pcap(stream_of(s, len(frames[0]))))["ATTITUDE"]["recv_ns"].to_pylist() for s in (frames, stream)
    )
    assert hurt[30:] == [at + 5 * len(frames[0]) * 10**5 for at in sound[30:]]


def test_a_connection_that_is_opened_again_is_another_stream() -> None:
    frames = flying(sender(), 60)
    opening = bytearray(tcp(b"", 10**6 - 1))
    opening[47] = 2
    packets = [*stream_of(frames[:30], 50, 10**9), (START_NS + 10**9, bytes(opening))]
    packets += [(t + 2 * 10**9, d) for t, d in stream_of(frames[30:], 50, 10**6)]
    flight = read(pcap(packets))
    assert flight.rows == 60
    assert not flight.damage.lossy
    assert "captured_twice" not in flight.info


def test_captures_are_not_scrubbed(tmp_path: Path) -> None:
    path = tmp_path / "a.pcapng"
    path.write_bytes(pcapng(over_udp(flying(sender(), 20))))
    with pytest.raises(UsageError, match="captures cannot be scrubbed"):
        scrub_log(path, tmp_path / "b.pcapng")


@given(st.lists(st.tuples(st.floats(0, 1), st.binary(max_size=60)), min_size=1, max_size=4))
@settings(max_examples=60, deadline=None)
def test_no_damage_to_a_capture_crashes_the_reader(edits: list[tuple[float, bytes]]) -> None:
    blob = bytearray(pcapng(over_tcp(flying(sender(), 40)) + over_udp(flying(sender(3), 40))))
    for share, content in edits:
        at = int(share * len(blob))
        blob[at : at + len(content)] = content
    with suppress(FormatError):
        read(bytes(blob))


def seen_by_any(packets: list[Packet], delay_ns: int, *, changed: Callable[[bytes], bytes] = bytes) -> bytes:
    """What the device "any" of Linux sees of packets that pass through: in, and a little later out."""
    cooked = []
    for time_ns, data in packets:
        for kind, at_ns, seen in ((0, time_ns, data), (4, time_ns + delay_ns, changed(data))):
            head = struct.pack(">HHH8s", kind, 1, 6, bytes(8))
            cooked.append((at_ns, head + seen[12:]))
    return pcap(sorted(cooked, key=lambda packet: packet[0]), link=113)


def numbered(packets: list[Packet], first: int = 1) -> list[Packet]:
    """The packets with numbers of their own, as their sender gives them."""
    return [(t, d[:18] + struct.pack(">H", first + i) + d[20:]) for i, (t, d) in enumerate(packets)]


def one_hop_on(frame: bytes) -> bytes:
    """As forwarded: another count of hops, and an address that was translated."""
    return frame[:22] + b"\x3f" + frame[23:26] + b"\xc0\xa8\x07\x01" + frame[30:]


@pytest.mark.parametrize("carry", [over_udp, over_tcp])
@pytest.mark.parametrize("delay_ns", [0, 40_000, 3_000_000])
def test_what_a_capture_on_all_interfaces_sees_twice_is_read_once(
    carry: Callable[[list[bytes]], list[Packet]], delay_ns: int
) -> None:
    packets = numbered(carry(flying(sender(), 200)))
    once = read(pcap(packets))
    twice = read(seen_by_any(packets, delay_ns))
    assert twice["ATTITUDE"].num_rows == once["ATTITUDE"].num_rows == 200
    assert int(twice.info["captured_twice"]) >= int(once.info.get("captured_twice", 0)) + 60
    assert not twice.damage.lossy
    assert twice.damage.sequence_gaps == once.damage.sequence_gaps


def test_a_datagram_that_is_forwarded_with_another_address_is_the_same_one() -> None:
    packets = numbered(over_udp(flying(sender(), 200)))
    flight = read(seen_by_any(packets, 50_000, changed=one_hop_on))
    assert flight["ATTITUDE"].num_rows == 200
    assert not flight.damage.lossy


def test_genuine_repeats_are_packets_and_copies_of_messages() -> None:
    """The capture holds two packets, whose message is one: a loop of routers sends it again."""
    frames = flying(sender(), 40)
    packets = [(START_NS + 20 * 10**6 * i, udp(frames[i])) for i in range(40)]
    again = [(t + 5 * 10**6, d) for t, d in packets]  # sent again: another packet of the same flow
    late = [(t + 11 * 10**6, d) for t, d in packets]  # later than the numbers can come round
    for second in (numbered(again, 1000), numbered(late)):
        both = sorted([*numbered(packets), *second], key=lambda packet: packet[0])
        flight = read(pcap(both))
        attitudes = flight["ATTITUDE"].num_rows
        assert attitudes + sum(flight.damage.repeats.values()) == 80
        assert attitudes == 40
        assert "captured_twice" not in flight.info


@pytest.mark.parametrize(
    ("at", "value"),
    [(16, b"\0\1"), (16, b"\0\x13"), (38, b"\0\0"), (38, b"\0\7"), (14, b"\x40"), (14, b"\x4f")],
)
def test_lengths_that_cannot_be_are_counted(at: int, value: bytes) -> None:
    packets = over_udp(flying(sender(), 100))
    time_ns, data = packets[20]
    packets[20] = (time_ns, data[:at] + value + data[at + len(value) :])
    flight = read(pcap(packets))
    assert flight["ATTITUDE"].num_rows == 98
    assert flight.damage.undecoded == {"packets": 1}


@pytest.mark.parametrize("option", [struct.pack("<2HB3x", 9, 1, 0), struct.pack("<2Hq", 14, 8, 2**63 - 1)])
def test_times_of_a_capture_that_cannot_be_are_counted(option: bytes) -> None:
    packets = over_udp(flying(sender(), 20))
    blob = pcapng(packets, nano=False)
    plain = block(1, struct.pack("<2HI", 1, 0, 65535), "<")
    flight = read(blob.replace(plain, block(1, struct.pack("<2HI", 1, 0, 65535) + option + bytes(4), "<")))
    assert flight["ATTITUDE"].num_rows == 20
    assert flight.damage.time_outliers["capture"] == len(packets)


def test_a_packet_larger_than_its_block_is_counted() -> None:
    packets = over_udp(flying(sender(), 100))
    blob = bytearray(pcapng(packets))
    at = blob.index(packets[40][1]) - 8
    blob[at : at + 4] = b"\xff\xff\xff\xff"
    flight = read(bytes(blob))
    assert flight["ATTITUDE"].num_rows == 98
    assert flight.damage.region_count == 1


def test_fragments_that_overlap_are_counted_and_cost_nothing_else() -> None:
    packets = over_udp(flying(sender(), 100))
    time_ns, data = packets[0]
    first, last = fragments(data, 7)
    shifted = (
        last[:20] + struct.pack(">H", 1) + last[22:-8]
    )  # begins inside the first one, and ends too early
    flood = [
        (time_ns, first[:20] + struct.pack(">H", 0x2000 | i) + first[22:] + bytes(1400)) for i in range(2000)
    ]
    for parts in ([(time_ns, first), (time_ns, shifted)], flood):
        flight = read(pcap([*parts, *packets[1:]]))
        assert flight["ATTITUDE"].num_rows == 98
        assert flight.damage.undecoded


def test_a_fragment_waits_no_longer_than_its_number_is_its_own() -> None:
    packets = over_udp(flying(sender(), 100))
    first, last = fragments(packets[10][1], 7)
    stale = packets[0][0] - 61 * 10**9, fragments(packets[8][1], 7)[1]
    parts = [(packets[10][0], first), (packets[10][0], last)]
    flight = read(pcap([stale, *packets[:10], *parts, *packets[11:]]))
    assert flight["ATTITUDE"].num_rows == 100


@pytest.mark.parametrize("step_s", [3 * 86_400, 10 * 31_557_600])
def test_a_capturing_clock_that_is_set_costs_no_packet(step_s: int) -> None:
    packets = over_udp(flying(sender(), 100))
    moved = [(t + (step_s * 10**9 if i >= 40 else 0), d) for i, (t, d) in enumerate(packets)]
    flight = read(pcap(moved))
    assert flight["ATTITUDE"].num_rows == 100
    assert flight.damage.bytes_skipped == 0


@pytest.mark.parametrize("pack", [pcap, pcapng])
@pytest.mark.parametrize("size", [3, 9, 17, 300_000])
def test_zeros_ahead_of_a_capture_hide_nothing(
    pack: Callable[[list[Packet]], bytes], size: int, tmp_path: Path
) -> None:
    """Up to eight of them may belong to a tlog's first stamp; none does to a capture."""
    path = tmp_path / "log"
    path.write_bytes(bytes(size) + pack(over_udp(flying(sender(), 60))))
    flight = flysid.read(path)
    assert flight.rows == 60
    assert flight.damage.bytes_skipped == size


@pytest.mark.parametrize("name", CARRIED)
def test_damaged_captures_keep_what_the_damage_leaves(name: str) -> None:
    for outcome in (
        cut(name, 397, lambda: True),
        flip(name, 60, lambda: True),
        insert(name, 30, lambda: True),
        delete(name, 15, lambda: True),
        length(name, 60, lambda: True),
    ):
        assert outcome.failures == []
        assert outcome.trials > 10
