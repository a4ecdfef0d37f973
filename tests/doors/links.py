"""What is at the other end of a link, or of a page, while a line runs."""

from __future__ import annotations

import re
import socket
import tempfile
import time
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from filelock import FileLock

from tests.doors.reader import Done, Reader, Running
from tests.link_sender import send

PORT = 14550
"""The pages' port: one door at a time may have it."""
_PORT_IS_TAKEN = Path(tempfile.gettempdir()) / f"flysid-doors-{PORT}.lock"
_ADDRESS = re.compile(r"http://127\.0\.0\.1:\d+/\S*")
_FITTING = re.compile(r'"model": "\w')
"""In a line of `--progress json`."""
_HEARD = re.compile(r"^[1-9][\d.]* s  \w+ (arrives|does not arrive)", re.MULTILINE)
"""Said of a channel at a time of the vehicle's clock, which is known once its frames have come."""
_FLOWN_S = 8.0
_FRAMES_HZ = 200.0
_ENOUGH_BYTES = 10_000


def recorded(file: str) -> Callable[[Reader, str], Done]:
    """A line that records into `file` until Ctrl-C, from a vehicle that sends."""

    def act(running: Running, target: Path) -> None:
        def has_come() -> bool:
            with suppress(ConnectionRefusedError):  # nobody listens yet
                send(PORT, _FRAMES_HZ, 0.2)
            return target.is_file() and target.stat().st_size > _ENOUGH_BYTES

        running.wait_for(has_come)

    def drive(reader: Reader, line: str) -> Done:
        with FileLock(_PORT_IS_TAKEN):
            return reader.run_while(line, lambda running: act(running, reader.folder / file))

    return drive


def flown(reader: Reader, line: str) -> Done:
    """A line that listens until Ctrl-C, to the vehicle of docs/vehicle.md, which flies a while and lands."""
    vehicle = f"flysid synth --plant ardrone --plan pilot --live udp:127.0.0.1:{PORT}"

    def act(running: Running) -> None:
        running.wait_for_words("shows faults as they occur")
        reader.run_while(vehicle, lambda _: time.sleep(_FLOWN_S))
        running.wait_for(lambda: _HEARD.search(running.out.read_text("utf-8")))

    with FileLock(_PORT_IS_TAKEN):
        return reader.run_while(line, act)


def notified(reader: Reader, line: str) -> Done:
    """`flown`, of a line that hands every event to ./notify.sh."""
    script = reader.folder / "notify.sh"
    script.write_text("#!/bin/sh\ncat >> events\n", "utf-8")
    script.chmod(0o700)
    done = flown(reader, line)
    assert "does not arrive" in (reader.folder / "events").read_text("utf-8")
    return done


def heard(reader: Reader, line: str) -> Done:
    """A line that sends to the port until Ctrl-C: something must come."""

    def act(running: Running) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.bind(("127.0.0.1", PORT))
            link.setblocking(False)
            running.wait_for(lambda: _received(link))

    with FileLock(_PORT_IS_TAKEN):
        return reader.run_while(line, act)


def served(reader: Reader, line: str) -> Done:
    """A line that serves a page until Ctrl-C: the page is there."""
    with FileLock(_PORT_IS_TAKEN):
        return reader.run_while(line, _look_at_page)


def fitting_has_begun(running: Running) -> None:
    """Wait until a fit has accepted its words, read its flights and fits a model, or has ended."""
    running.wait_for(lambda: running.process.poll() is not None or _FITTING.search(running.err.read_text()))


def until(words: str) -> Callable[[Reader, str], Done]:
    """A line that goes on until Ctrl-C, which comes after these words."""
    return lambda reader, line: reader.run_while(line, lambda running: running.wait_for_words(words))


def _look_at_page(running: Running) -> None:
    running.wait_for(lambda: _ADDRESS.search(running.out.read_text("utf-8")) is not None)
    found = _ADDRESS.search(running.out.read_text("utf-8"))
    assert found is not None
    browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    with browser.open(found[0], timeout=60) as answer:
        assert b"<html" in answer.read()


def _received(link: socket.socket) -> bool:
    try:
        return bool(link.recv(4096))
    except BlockingIOError:
        time.sleep(0.01)
        return False
