"""`flysid record` against real sockets, a pseudo-terminal and a real disk."""

from __future__ import annotations

import os
import random
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

import flysid
from flysid.errors import UsageError
from flysid.live.links import open_link, parse_link
from flysid.live.receiving import warm_up
from flysid.live.recording import Recording
from flysid.live.recording_parts import Rotation, parse_rotation
from flysid.live.spool import Spool, SpoolPiece
from tests import link_trials
from tests.link_sender import frames
from tests.link_trials import free_port, without_stamps

POOL = frames()
ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True, scope="module")
def _compiled() -> None:
    warm_up()


@contextmanager
def recording(target: Path, *links: str, **settings: Any) -> Iterator[Recording]:
    """A recording in this process; stopped at the end."""
    opened = [open_link(link, sends=settings.get("heartbeat", False)) for link in links]
    made = Recording(opened, target, **settings)
    made.start()
    try:
        yield made
    finally:
        made.stop()


def wait_for(count: int, made: Recording) -> None:
    until = time.monotonic() + 60.0
    while made.receiver.ledger.senders["frames"].sum() < count:
        assert time.monotonic() < until
        time.sleep(0.01)


def senders(made: Recording, link: int = 0) -> list[dict[str, Any]]:
    return [row for peer in made.last_facts["links"][link]["peers"] for row in peer["systems"]]


def send(port: int, *contents: bytes, at: socket.socket | None = None) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for content in contents:
            (at or link).sendto(content, ("127.0.0.1", port))


def test_what_was_sent_is_what_pymavlink_and_flysid_read(tmp_path: Path) -> None:
    port = free_port()
    target = tmp_path / "flight.tlog"
    before = time.time()
    with recording(target, f"udp:127.0.0.1:{port}") as made:
        send(port, *POOL)
        wait_for(256, made)
    assert without_stamps(target) == b"".join(POOL)
    reader = mavutil.mavlink_connection(str(target))
    heard = []
    while (message := reader.recv_msg()) is not None:
        heard.append(bytes(message.get_msgbuf()))
        assert before - 1.0 < message._timestamp < time.time() + 1.0
    reader.close()
    assert heard == POOL
    flight = flysid.read(target)
    assert flight.damage.bytes_skipped == 0
    assert sum(len(flight[name]) for name in flight) == 256
    assert senders(made)[0]["lost_by_sequence"] == 0


def test_times_are_the_kernels(tmp_path: Path) -> None:
    """Frames that wait in the socket while nobody reads keep the times at which they came."""
    port = free_port()
    link = open_link(f"udp:127.0.0.1:{port}")
    time.sleep(0.2)  # the first user of time stamps switches them on, a moment later
    came = []
    for frame in POOL[:3]:
        before = time.time()
        send(port, frame)
        time.sleep(0.3)
        came.append((before, time.time()))  # a busy kernel stamps late; the reader comes a second later
    made = Recording([link], tmp_path / "late.tlog")
    made.start()
    wait_for(3, made)
    made.stop()
    reader = mavutil.mavlink_connection(str(tmp_path / "late.tlog"))
    for before, after in came:
        assert before - 0.01 < reader.recv_msg()._timestamp < after + 0.01
    reader.close()


def test_two_vehicles_with_one_number_are_told_apart(tmp_path: Path) -> None:
    port = free_port()
    with recording(tmp_path / "two.tlog", f"udp:127.0.0.1:{port}") as made:
        with socket.socket(type=socket.SOCK_DGRAM) as one, socket.socket(type=socket.SOCK_DGRAM) as other:
            for k in range(60):
                send(port, POOL[k], at=one)
                send(port, POOL[k + 100], at=other)
        wait_for(120, made)
    rows = senders(made)
    assert [row["frames"] for row in rows] == [60, 60]
    assert [row["lost_by_sequence"] for row in rows] == [0, 0]
    assert any("system 1 comes from" in text for text in made.last_facts["warnings"])


def test_ten_systems_on_two_links(tmp_path: Path) -> None:
    ports = [free_port(), free_port()]
    with recording(tmp_path / "ten.tlog", *(f"udp:127.0.0.1:{port}" for port in ports)) as made:
        for system in range(1, 11):
            send(ports[system % 2], *frames(system)[:50])
        wait_for(500, made)
    assert sorted(row["system"] for link in (0, 1) for row in senders(made, link)) == list(range(1, 11))
    assert not made.last_facts["warnings"]


def test_garbage_is_kept_beside_and_costs_no_frame(tmp_path: Path) -> None:
    port = free_port()
    target = tmp_path / "noisy.tlog"
    noise = random.Random(5).randbytes(1000)
    with recording(target, f"udp:127.0.0.1:{port}") as made:
        noisy = [part for frame in POOL[:100] for part in (noise, frame)]
        send(port, *noisy, *POOL[100:120])  # the last are longer than any frame that noise may seem to begin
        wait_for(120, made)
    kept = without_stamps(target)
    assert all(frame in kept for frame in POOL[:120])
    peer = made.last_facts["links"][0]["peers"][0]
    rejected = target.with_suffix(".rejects").stat().st_size
    assert peer["bytes_that_are_no_frame"] == rejected
    assert rejected + len(kept) == 100 * len(noise) + sum(map(len, POOL[:120]))


def test_nothing_is_sent_without_heartbeat(tmp_path: Path) -> None:
    port = free_port()
    with socket.socket(type=socket.SOCK_DGRAM) as vehicle:
        vehicle.settimeout(1.5)
        with recording(tmp_path / "silent.tlog", f"udp:127.0.0.1:{port}"):
            send(port, POOL[0], at=vehicle)
            with pytest.raises(TimeoutError):
                vehicle.recv(1000)


def test_heartbeats_reach_who_needs_them(tmp_path: Path) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(5.0)
        link = f"udpout:127.0.0.1:{server.getsockname()[1]}"
        with recording(tmp_path / "out.tlog", link, heartbeat=True) as made:
            beat, address = server.recvfrom(1000)
            server.sendto(POOL[0], address)
            wait_for(1, made)
    parser = mavutil.mavlink.MAVLink(None)
    assert parser.parse_char(beat).get_type() == "HEARTBEAT"
    assert senders(made)[0]["frames"] == 1


def test_udpout_without_heartbeat_would_hear_nothing() -> None:
    with pytest.raises(UsageError, match="would receive nothing"):
        open_link("udpout:127.0.0.1:14550")


def test_a_pseudo_terminal_is_a_serial_link(tmp_path: Path) -> None:
    master, slave = os.openpty()
    target = tmp_path / "serial.tlog"
    with recording(target, f"serial:{os.ttyname(slave)}:115200") as made:
        stream = b"noise" + b"".join(POOL[:100])
        for at in range(0, len(stream), 37):
            os.write(master, stream[at : at + 37])
            time.sleep(0.001)
        wait_for(100, made)
    os.close(master)
    os.close(slave)
    assert without_stamps(target) == b"".join(POOL[:100])
    assert target.with_suffix(".rejects").read_bytes() == b"noise"


def test_a_tcp_link_that_breaks_is_opened_again(tmp_path: Path) -> None:
    target = tmp_path / "tcp.tlog"
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = f"tcp:127.0.0.1:{server.getsockname()[1]}"
        with recording(target, link) as made:
            first, _ = server.accept()
            first.sendall(b"".join(POOL[:50]) + POOL[50][:10])
            wait_for(50, made)
            first.close()
            second, _ = server.accept()
            second.sendall(b"".join(POOL[60:100]))
            wait_for(90, made)
            second.close()
    assert without_stamps(target) == b"".join(POOL[:50] + POOL[60:100])
    assert target.with_suffix(".rejects").read_bytes() == POOL[50][:10]


def test_a_link_that_is_not_there_is_a_state(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with recording(tmp_path / "none.tlog", f"tcp:127.0.0.1:{port}") as made:
        assert "refused" in made.links[0].state
    assert made.last_facts["warnings"]


def test_a_port_in_use_is_named() -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(UsageError, match="in use") as caught:
            open_link(f"udp:127.0.0.1:{taken.getsockname()[1]}")
    assert "mavlink-router" in caught.value.hint


@pytest.mark.parametrize("text", ["udp", "udp:host", "udp:host:0", "http:a:1", "serial:", "tcp:a:b"])
def test_links_that_are_not_understood(text: str) -> None:
    with pytest.raises(UsageError, match="no link"):
        parse_link(text)


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (["256MB"], Rotation(size=256_000_000)),
        (["10min", "boot"], Rotation(seconds=600.0, boot=True)),
        (["1.5h"], Rotation(seconds=5400.0)),
    ],
)
def test_rotations(words: list[str], rule: Rotation) -> None:
    assert parse_rotation(words) == rule


@pytest.mark.parametrize("word", ["", "10", "MB", "-1MB", "0s", "5 parsecs"])
def test_rotations_that_are_not_understood(word: str) -> None:
    with pytest.raises(UsageError, match="rotation"):
        parse_rotation([word])


def test_a_target_that_exists_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "old.tlog").write_bytes(b"precious")
    link = open_link(f"udp:127.0.0.1:{free_port()}")
    with pytest.raises(UsageError, match="exists"):
        Recording([link], tmp_path / "old.tlog")
    link.close()
    assert (tmp_path / "old.tlog").read_bytes() == b"precious"


def test_parts_joined_are_the_whole(tmp_path: Path) -> None:
    port = free_port()
    with recording(tmp_path / "parts.tlog", f"udp:127.0.0.1:{port}", rotation=Rotation(size=3000)) as made:
        for first in range(0, 256, 32):
            send(port, *POOL[first : first + 32])
            wait_for(first + 32, made)
            time.sleep(0.1)  # written in between
    parts = sorted(tmp_path.glob("parts-*.tlog"))
    assert len(parts) > 3
    assert b"".join(map(without_stamps, parts)) == b"".join(POOL)


def test_a_new_part_begins_where_a_vehicle_was_started_anew(tmp_path: Path) -> None:
    from tests.flysid.live.test_ledger import told_times

    port = free_port()
    before = told_times([60_000 + k for k in range(50)])
    after = told_times([200 + k for k in range(30)])
    with recording(tmp_path / "boots.tlog", f"udp:127.0.0.1:{port}", rotation=Rotation(boot=True)) as made:
        send(port, *before, *after)
        wait_for(80, made)
    parts = sorted(tmp_path.glob("*.tlog"))
    assert [path.name for path in parts] == ["boots-0001.tlog", "boots-0002.tlog"]
    assert [without_stamps(path) for path in parts] == [b"".join(before), b"".join(after)]


def test_a_listener_hears_what_is_written(tmp_path: Path) -> None:
    port = free_port()
    heard: list[SpoolPiece] = []
    with recording(tmp_path / "heard.tlog", f"udp:127.0.0.1:{port}", listener=heard.append) as made:
        send(port, *POOL)
        wait_for(256, made)
    assert b"".join(piece.content for piece in heard) == (tmp_path / "heard.tlog").read_bytes()


def test_the_queue_is_bounded_and_counts() -> None:
    spool = Spool(limit=1000)
    for k in range(20):
        spool.put(SpoolPiece(bytes([k]) * 100, 1))
    kept = spool.take()
    assert spool.dropped_frames == 10
    assert [piece.content[0] for piece in kept] == list(range(10, 20))


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux")
class TestTrials:
    """The soak's trials at a small size; what takes CPU or time is judged by the soak alone."""

    def test_small_buffer(self, tmp_path: Path) -> None:
        outcome = link_trials.small_buffer(tmp_path, 5_000, 3.0)
        assert outcome.failures == [], outcome.remark

    def test_killed(self, tmp_path: Path) -> None:
        assert link_trials.killed(tmp_path, 1, 2_000, most_missing_s=60.0).failures == []

    def test_full_disk(self, tmp_path: Path) -> None:
        try:
            assert link_trials.full_disk(tmp_path, "512k", 5_000).failures == []
        except PermissionError:
            pytest.skip("this user may not mount")

    def test_stalled_disk(self, tmp_path: Path) -> None:
        try:
            assert link_trials.stalled_disk(tmp_path, 2_000, 1.5).failures == []
        except PermissionError as error:
            pytest.skip(f"cannot freeze a file system here: {error}")


def test_threads_end_with_the_recording(tmp_path: Path) -> None:
    before = threading.active_count()
    with recording(tmp_path / "short.tlog", f"udp:127.0.0.1:{free_port()}"):
        pass
    assert threading.active_count() == before
