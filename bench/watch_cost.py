"""`python -m bench.watch_cost FOLDER [--seconds 60] [--rate 400]`: a live watch's cost, and how late it is.

Three channels of a simulated vehicle are fitted in FOLDER (kept for the next time), and a flight is sent to
`flysid watch` over UDP in real time, with messages between that no channel uses, until so many frames a
second go out. Its forward speed is off for 5 s of every 20 s. CPU is that of all threads of the watching
process; an alarm's delay is from sending the frame that completes its sample to the line of text.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from flysid.ingest.formats.mavlink.frames import read_header
from flysid.ingest.synth.synth import Order, fly_one
from flysid.ingest.synth.telemetry import Telemetry
from flysid.ingest.synth.writers.mavlink import tlog_bytes
from tests.link_trials import ROOT, Recorder, free_port

PLACED = 32  # LOCAL_POSITION_NED completes a sample


def prepared(folder: Path) -> Path:
    """The run of three channels; fitted where it is not there yet."""
    run = folder / "run"
    if not run.exists():
        (folder / "logs").mkdir(parents=True, exist_ok=True)
        order = Order(plan="mixed", duration_s=120.0, seed=5)
        for k in range(4):
            (folder / "logs" / f"{k}.tlog").write_bytes(tlog_bytes(fly_one(order, k)))
        fit = [
            "tests.quick_flysid",
            "fit",
            folder / "data",
            "-r",
            "ardrone-synthetic",
            "-o",
            run,
            "--jobs",
            "1",
        ]
        for words in (
            ["flysid", "ingest", folder / "logs", "-o", folder / "data"],
            [*fit, "--holdout", "0.5"],
        ):
            subprocess.run([sys.executable, "-m", *map(str, words)], cwd=ROOT, check=True)
    return run


def flight(seconds: float) -> list[tuple[int, bytes]]:
    """(microseconds, frame) of a flight whose forward speed is off now and then."""
    recording = fly_one(Order(plan="mixed", duration_s=seconds, seed=6), 0)
    at_s = (recording.state.time_ns - recording.state.time_ns[0]) * 1e-9
    values = {**recording.state.values, "vx": recording.state["vx"] + 0.4 * (at_s % 20.0 > 15.0)}
    content = tlog_bytes(replace(recording, state=Telemetry(recording.state.time_ns, values)))
    found = []
    at = 0
    while at < len(content):
        head = read_header(content, at + 8)
        assert head is not None
        found.append((int.from_bytes(content[at : at + 8], "big"), content[at + 8 : head.end]))
        at = head.end
    return found


def fillers(count: int, first_us: int, last_us: int) -> list[tuple[int, bytes]]:
    """So many messages of an autopilot that no channel asks for, spread evenly."""
    from pymavlink.dialects.v20 import common

    link = common.MAVLink(None, srcSystem=1, srcComponent=1)
    times = np.linspace(first_us, last_us, count).astype(np.int64).tolist()
    return [(at, bytes(link.raw_imu_encode(at, *(9 * [0])).pack(link))) for at in times]


def play(frames: list[tuple[int, bytes]], port: int, sent_s: dict[int, float]) -> None:
    """Send every frame at its time; notes when the samples' last frames went out, by vehicle time in ms."""
    began = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for at_us, frame in frames:
            time.sleep(max(0.0, (at_us - frames[0][0]) * 1e-6 - (time.monotonic() - began)))
            if int.from_bytes(frame[7:10], "little") == PLACED:
                sent_s[int.from_bytes(frame[10:14], "little")] = time.monotonic()
            link.sendto(frame, ("127.0.0.1", port))


def main() -> None:
    """Print the share of a core, and the delays."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=400.0)
    options = parser.parse_args()
    run = prepared(options.folder)
    frames = flight(options.seconds)
    more = max(0, round(options.rate * options.seconds) - len(frames))
    frames = sorted([*frames, *fillers(more, frames[0][0], frames[-1][0])], key=lambda pair: pair[0])
    port = free_port()
    command = [sys.executable, "-u", "-m", "flysid", "watch", str(run), f"udp:127.0.0.1:{port}", "--json"]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stderr is not None
    for text in process.stderr:
        if text.startswith("vertical"):
            break
    time.sleep(3.0)
    alarms: list[tuple[float, float]] = []

    def listen() -> None:
        assert process.stdout is not None
        for text in process.stdout:
            event = json.loads(text)
            if event["kind"] == "alarm":
                alarms.append((event["time_s"], time.monotonic()))

    threading.Thread(target=listen, daemon=True).start()
    sent_s: dict[int, float] = {}
    watch = Recorder(process, Path())
    before = watch.cpu_s()
    began = time.monotonic()
    play(frames, port, sent_s)
    share = (watch.cpu_s() - before) / (time.monotonic() - began)
    time.sleep(1.0)
    process.terminate()
    process.wait()
    print(f"{len(frames) / options.seconds:.0f} frames/s, 3 channels at 50 Hz: {100 * share:.1f} % of a core")
    late = sorted(1e3 * (said - sent_s[round(1e3 * at)]) for at, said in alarms if round(1e3 * at) in sent_s)
    if late:
        print(f"{len(late)} alarms after {np.median(late):.0f} ms (median), {late[-1]:.0f} ms (latest)")


if __name__ == "__main__":
    main()
