"""Real senders: pymavlink, flysid's own, MAVProxy and mavlink-router where they are installed."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from pymavlink import mavutil

import flysid
from tests.flysid.live.test_recording import POOL, ROOT, recording, wait_for
from tests.link_trials import free_port, without_stamps


def test_pymavlink_sends_and_reads_again(tmp_path: Path) -> None:
    port = free_port()
    with recording(tmp_path / "p.tlog", f"udp:127.0.0.1:{port}") as made:
        sender = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=7)
        for k in range(100):
            sender.mav.attitude_send(k, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)
            sender.mav.statustext_send(6, f"text {k}".encode())
        wait_for(200, made)
        sender.close()
    reader = mavutil.mavlink_connection(str(tmp_path / "p.tlog"))
    texts = []
    while (message := reader.recv_match(type="STATUSTEXT")) is not None:
        texts.append(message.text)
    reader.close()
    assert texts == [f"text {k}" for k in range(100)]
    assert made.last_facts["links"][0]["peers"][0]["systems"][0]["system"] == 7


def test_flysids_own_sender(tmp_path: Path) -> None:
    port = free_port()
    target = tmp_path / "s.tlog"
    with recording(target, f"udp:127.0.0.1:{port}") as made:
        words = ["synth", "--live", f"udp:127.0.0.1:{port}", "--duration", "5", "--speed", "20", "-q"]
        command = [sys.executable, "-m", "flysid", *words, "--plan", "paper"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        time.sleep(0.2)
    flight = flysid.read(target)
    assert flight.damage.bytes_skipped == 0
    assert len(flight["ATTITUDE"]) >= 250
    assert made.last_facts["links"][0]["dropped_by_host"] == 0


def through(router: list[str], first: int, second: int, target: Path) -> bytes:
    """Frames that come out of a router: it hears on port `first` and speaks to port `second`."""
    with recording(target, f"udp:127.0.0.1:{second}") as made:
        process = subprocess.Popen(
            router, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, cwd=target.parent
        )
        try:
            with socket.socket(type=socket.SOCK_DGRAM) as vehicle:
                until = time.monotonic() + 60.0
                while made.receiver.ledger.senders["frames"].sum() < 50 and time.monotonic() < until:
                    for frame in POOL:
                        vehicle.sendto(frame, ("127.0.0.1", first))
                        time.sleep(0.002)
        finally:
            process.terminate()
            process.communicate(timeout=20)
    assert made.last_facts["links"][0]["peers"][0]["bytes_that_are_no_frame"] == 0
    return without_stamps(target)


def test_mavproxy_forwards(tmp_path: Path) -> None:
    program = shutil.which("mavproxy.py")
    if program is None:
        pytest.skip("MAVProxy is not installed: pip install MAVProxy, in an environment of its own (GPL)")
    first = free_port()
    second = free_port()
    ports = [f"--master=udp:127.0.0.1:{first}", f"--out=udp:127.0.0.1:{second}"]
    got = through(
        [program, *ports, "--non-interactive", "--streamrate=-1"], first, second, tmp_path / "m.tlog"
    )
    assert sum(frame in got for frame in POOL) > 100


def test_mavlink_router_forwards(tmp_path: Path) -> None:
    program = shutil.which("mavlink-routerd")
    if program is None:
        pytest.skip("mavlink-router is not installed")
    first = free_port()
    second = free_port()
    words = [program, "-t", "0", "-e", f"127.0.0.1:{second}", f"127.0.0.1:{first}"]
    got = through(words, first, second, tmp_path / "r.tlog")
    assert sum(frame in got for frame in POOL) > 100
