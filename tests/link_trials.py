"""Trials of `flysid record`, for tests (seconds) and for `python -m soak record` (at full size)."""

from __future__ import annotations

import json
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from flysid.live.spool import whole_records
from soak import Outcome
from tests.fault_trials import small_disk
from tests.link_sender import frames

ROOT = Path(__file__).resolve().parents[1]
DEFAULT_BUFFER = 212_992
FREEZE = "fsfreeze"


def free_port() -> int:
    """A UDP port that nobody uses just now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Recorder:
    """`flysid record` in a process of its own."""

    process: subprocess.Popen[str]
    target: Path

    def stop(self) -> tuple[int, str]:
        """Interrupt it, as Ctrl-C does; exit code and stderr."""
        self.process.send_signal(signal.SIGINT)
        _, said = self.process.communicate(timeout=60)
        return self.process.returncode, said

    def cpu_s(self) -> float:
        """CPU time of all its threads so far."""
        tasks = Path(f"/proc/{self.process.pid}/task").glob("*/schedstat")
        return sum(int(task.read_text().split()[0]) for task in tasks) * 1e-9

    def sidecar(self) -> dict[str, Any]:
        """What stands beside the file."""
        document: dict[str, Any] = json.loads(self.target.with_name(self.target.name + ".json").read_text())
        return document


@contextmanager
def recorder(target: Path, links: Sequence[str], *more: str) -> Iterator[Recorder]:
    """A recorder that has begun; ended at the end if it still runs."""
    command = [sys.executable, "-m", "flysid", "record", *links, "-o", str(target), *more]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, cwd=ROOT, stdout=pipe, stderr=pipe, text=True)
    try:
        until = time.monotonic() + 300.0
        while process.poll() is None and not any(target.parent.glob(f"{target.stem}*.json")):
            if time.monotonic() > until:
                raise TimeoutError("the recorder does not begin")
            time.sleep(0.02)
        yield Recorder(process, target)
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def sender(port: int, rate: float, seconds: float, *more: str) -> subprocess.Popen[str]:
    """A process that sends; its stdout says how many frames."""
    command = [sys.executable, "-m", "tests.link_sender", str(port), str(rate), str(seconds), *more]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)


def sent_by(process: subprocess.Popen[str]) -> int:
    """How many frames it has sent, once it is through."""
    said, _ = process.communicate()
    return int(said)


def dropped(document: dict[str, Any]) -> int:
    """What the host dropped, by the sidecar: in the kernel and in the queue."""
    kernel = sum(link["dropped_by_host"] or 0 for link in document["links"])
    return int(kernel + document["queue"]["dropped_frames"])


def records_of(path: Path) -> tuple[int, int]:
    """Whole records in a file, and bytes behind the last."""
    content = path.read_bytes()
    size, count = whole_records(content, len(content))
    return count, len(content) - size


def steady(folder: Path, rate: int, seconds: float, goal_us: float) -> Outcome:
    """A steady rate: nothing lost, and the CPU of a frame."""
    outcome = Outcome(f"{rate:,} frames/s for {seconds:g} s")
    port = free_port()
    with outcome.trial(), recorder(folder / f"r{rate}.tlog", [f"udp:127.0.0.1:{port}"]) as record:
        before = record.cpu_s()
        sent = sent_by(sender(port, rate, seconds))
        time.sleep(0.2)
        spent = record.cpu_s() - before
        code, said = record.stop()
        written, behind = records_of(record.target)
        lost = sent - written - dropped(record.sidecar())
        outcome.keep(written, sent)
        each = 1e6 * spent / sent
        outcome.remark = (
            f"{each:.1f} us of CPU a frame (goal {goal_us:g}), {sent / seconds:,.0f} frames/s came"
        )
        if written != sent or behind or code:
            outcome.failures.append(f"{lost} lost, {behind} bytes behind, exit {code}: {said}")
        if each > goal_us:
            outcome.failures.append(f"{each:.1f} us of CPU a frame")
    return outcome


def dropped_by_kernel(port: int) -> int:
    """Datagrams that the kernel had no room for, of the socket at a port."""
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return sum(int(row[-1]) for row in rows if int(row[1].rpartition(":")[2], 16) == port)


def small_buffer(folder: Path, rate: int, seconds: float) -> Outcome:
    """The system's usual buffer, and a recorder that the system does not run until that has overflowed."""
    outcome = Outcome(f"buffer of {DEFAULT_BUFFER:,} bytes, held up until it overflows")
    port = free_port()
    more = ("--buffer", str(DEFAULT_BUFFER))
    with outcome.trial(), recorder(folder / "small.tlog", [f"udp:127.0.0.1:{port}"], *more) as record:
        sending = sender(port, rate, seconds)
        while not record.target.stat().st_size and sending.poll() is None:
            time.sleep(0.02)
        record.process.send_signal(signal.SIGSTOP)
        while not dropped_by_kernel(port) and sending.poll() is None:
            time.sleep(0.02)
        record.process.send_signal(signal.SIGCONT)
        sent = sent_by(sending)
        time.sleep(0.2)
        code, said = record.stop()
        written, _ = records_of(record.target)
        gone = dropped(record.sidecar())
        systems = record.sidecar()["links"][0]["peers"][0]["systems"][0]
        by_sequence = systems["lost_by_sequence"] + systems["lost_in_silence_about"]
        outcome.keep(written, sent)
        outcome.remark = (
            f"sent {sent:,} = written {written:,} + dropped {gone:,}; the sequence says {by_sequence:,}"
        )
        if sent != written + gone or not gone or code != 3 or "sysctl" not in said:
            outcome.failures.append(f"exit {code}, {outcome.remark}: {said}")
    return outcome


def killed(
    folder: Path,
    count: int,
    rate: int,
    goes_on: Callable[[], bool] = lambda: True,
    *,
    most_missing_s: float = 1.5,
) -> Outcome:
    """`kill -9` at random moments: files are sound but for one cut frame, and little is missing."""
    outcome = Outcome("kill -9")
    chance = random.Random(24)
    worst = 0.0
    for k in range(count):
        if not goes_on():
            break
        port = free_port()
        with outcome.trial(), recorder(folder / f"k{k}.tlog", [f"udp:127.0.0.1:{port}"]) as record:
            sending = sender(port, rate, 60.0)
            while not record.target.stat().st_size and sending.poll() is None:
                time.sleep(0.02)
            time.sleep(chance.uniform(0.0, 2.0))
            killed_at = time.time()
            record.process.kill()
            record.process.wait()
            sending.kill()
            sending.communicate()
            content = record.target.read_bytes()
            size, frames_kept = whole_records(content, len(content))
            missing_s = killed_at - newest_s(content, size)
            worst = max(worst, missing_s)
            if not frames_kept or missing_s > most_missing_s or len(content) - size > 300:
                outcome.failures.append(
                    f"{frames_kept} frames, {missing_s:.2f} s, {len(content) - size} bytes behind"
                )
    outcome.remark = f"at most {worst:.2f} s missing at {rate:,} frames/s"
    return outcome


def newest_s(content: bytes, size: int) -> float:
    """Time of the last whole record; 0 where there is none."""
    at = 0
    stamp = 0
    while at < size:
        stamp = int.from_bytes(content[at : at + 8], "big")
        at += _length(content, at)
    return stamp * 1e-6


def _length(content: bytes, at: int) -> int:
    from flysid.ingest.formats.mavlink.frames import read_header

    head = read_header(content, at + 8)
    assert head is not None
    return head.end - at


def rotated(folder: Path, rate: int, seconds: float, rule: str) -> Outcome:
    """Parts, one behind the other, are what was sent."""
    outcome = Outcome(f"rotation, {rule}")
    port = free_port()
    link = f"udp:127.0.0.1:{port}"
    with outcome.trial(), recorder(folder / "parts.tlog", [link], "--rotate", rule) as record:
        sending = sender(port, rate, seconds, str(folder / "sent.bin"))
        sent_by(sending)
        time.sleep(0.2)
        code, said = record.stop()
    parts = sorted(folder.glob("parts-*.tlog"))
    joined = b"".join(map(without_stamps, parts))
    outcome.remark = f"{len(parts)} parts"
    if code or len(parts) < 2 or joined != (folder / "sent.bin").read_bytes():
        outcome.failures.append(f"exit {code}, {len(parts)} parts, {len(joined):,} bytes: {said}")
    return outcome


def without_stamps(path: Path) -> bytes:
    """The frames of a tlog alone."""
    content = path.read_bytes()
    at = 0
    found = []
    while at < len(content):
        length = _length(content, at)
        found.append(content[at + 8 : at + length])
        at += length
    return b"".join(found)


def full_disk(folder: Path, size: str, rate: int) -> Outcome:
    """A disk that fills up: exit 5, a sound file, a sidecar that says so. Raises PermissionError."""
    outcome = Outcome(f"full disk of {size}")
    port = free_port()
    with outcome.trial(), small_disk(folder / "disk", size) as disk:
        with recorder(disk / "full.tlog", [f"udp:127.0.0.1:{port}"]) as record:
            sent = sent_by(sender(port, rate, 4.0))
            time.sleep(0.2)
            code, said = record.stop()
        written, behind = records_of(record.target)
        document = record.sidecar()
        counted = written + document["written"]["frames_not_written"] + dropped(document)
        outcome.remark = f"{written:,} of {sent:,} frames written, the others counted"
        if code != 5 or behind or document["state"] != "stopped" or counted != sent or not written:
            outcome.failures.append(
                f"exit {code}, {behind} bytes behind, {document['state']}, {counted}: {said}"
            )
    return outcome


def stalled_disk(folder: Path, rate: int, stall_s: float) -> Outcome:
    """A file system that is frozen for a while loses nothing. Raises PermissionError where none may be."""
    outcome = Outcome(f"disk stalled for {stall_s:g} s")
    port = free_port()
    with outcome.trial(), frozen_disk(folder / "disk", folder / "image") as (disk, freeze):
        with recorder(disk / "stalled.tlog", [f"udp:127.0.0.1:{port}"]) as record:
            sending = sender(port, rate, stall_s + 4.0)
            time.sleep(2.0)
            freeze("-f")
            time.sleep(stall_s)
            freeze("-u")
            sent = sent_by(sending)
            time.sleep(0.5)
            code, said = record.stop()
        written, behind = records_of(record.target)
        peak = record.sidecar()["queue"]["peak_bytes"]
        outcome.keep(written, sent)
        outcome.remark = f"{peak / 1e6:.1f} MB waited at most"
        if code or behind or written != sent or peak < 0.5 * rate * stall_s * 40:
            outcome.failures.append(f"exit {code}, {written} of {sent}, {outcome.remark}: {said}")
    return outcome


@contextmanager
def frozen_disk(folder: Path, image: Path) -> Iterator[tuple[Path, Callable[[str], None]]]:
    """An ext4 file system in a file, and what freezes (-f) and thaws (-u) it."""
    folder.mkdir(parents=True)
    image.write_bytes(b"")
    with image.open("r+b") as file:
        file.truncate(64 << 20)
    steps = [["mkfs.ext4", "-q", str(image)], ["mount", "-o", "loop", str(image), str(folder)]]
    for step in steps:
        try:
            subprocess.run(step, check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError) as error:
            raise PermissionError(step[0]) from error

    def freeze(flag: str) -> None:
        subprocess.run([FREEZE, flag, str(folder)], check=True, capture_output=True)

    try:
        yield folder, freeze
    finally:
        subprocess.run([FREEZE, "-u", str(folder)], capture_output=True, check=False)
        subprocess.run(["umount", "-l", str(folder)], capture_output=True, check=False)


def every_frame_comes_back(path: Path) -> bool:
    """Whether the frames of a tlog are those of the sender, in order, from the first on."""
    pool = frames()
    content = without_stamps(path)
    whole = b"".join(pool)
    times = len(content) // len(whole) + 1
    return (whole * times).startswith(content)
