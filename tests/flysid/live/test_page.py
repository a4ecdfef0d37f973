"""The live page in a real browser: a vehicle over UDP, beside its model, with a fault."""

from __future__ import annotations

import json
import random
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from flysid.cli.studio import open_session
from flysid.live.links import open_link
from flysid.live.recording import Recording
from flysid.live.session import Session
from flysid.live.spool import whole_records
from flysid.live.traces import Trace
from flysid.studio.live_server import _Server
from flysid.studio.loopback import Key, bound
from tests.browser import needs_browser
from tests.command import call
from tests.flysid.live.flown import FAULT_S, play
from tests.flysid.studio.page import Page, until
from tests.flysid.studio.server import Server, studio
from tests.link_trials import free_port

SPEED = 8.0
GARBAGE = 50  # datagrams of 1,200 bytes: even the smallest buffer holds them until somebody reads
STATE = """
const { charts, view } = document.querySelector("main").live;
return { rows: charts[0].rows, end: view.end, span: view.span, newest: view.newest };
"""


def test_a_reader_who_comes_late_is_given_newer_rows_and_all_that_may_have_changed() -> None:
    trace = Trace(outputs=1, capacity=8, settles=2)
    for k in range(6):
        y = np.array([[2.0 * k], [2.0 * k + 1]])
        trace.add(2.0 * k, 1.0, y, y + 0.5)
    trace.add_run(np.array([[7.0], [8.0], [9.0]]))
    first, rows = trace.since(0)
    assert first == 4  # eight are kept
    assert [row[0] for row in rows] == list(range(4, 12))
    assert [row[3] for row in rows] == [None] * 6 + [8.0, 9.0]
    assert trace.since(12) == (10, rows[-2:])
    assert trace.since(0, most=3)[0] == 9
    trace.add(12.0, 1.0, np.arange(20.0)[:, None], np.zeros((20, 1)))  # more than the ring holds
    assert [row[1] for row in trace.since(0)[1]] == list(range(12, 20))


def test_without_a_link_there_is_no_live_page(tmp_path: Path) -> None:
    pytest.importorskip("starlette", reason='the studio is not installed: pip install "flysid[studio]"')
    with studio(tmp_path / "data") as server:
        assert server.get("about").json["live"] is False
        refused = server.get("live")
        assert (refused.status, refused.json["hint"]) == (404, "flysid studio --live udp:0.0.0.0:14550")


def test_the_page_alone_lets_in_whom_the_studio_would(tmp_path: Path) -> None:
    link = f"udp:127.0.0.1:{free_port()}"
    with studio(tmp_path / "data", "--live", link, module="tests.bare_flysid") as server:
        assert server.raw("GET", "/").status == 401
        assert server.raw("GET", "/", headers={"Host": "evil.example"}).status == 421
        known = {"Cookie": server.cookie}
        assert server.raw("GET", "/", headers={**known, "Origin": "http://evil.example"}).status == 403
        page = server.raw("GET", "/", headers=known)
        assert page.status == 200
        assert page.headers["content-security-policy"].startswith("default-src 'none'")
        assert server.raw("GET", "/../app.py", headers=known).status == 404
        assert server.raw("POST", "/", b"x", known).status == 501
        assert server.get("live").json["links"] == [link]
    kept = list((tmp_path / "data.studio" / "recordings").glob("*.tlog.json"))
    assert [json.loads(path.read_text())["state"] for path in kept] == ["closed"]


def test_a_browser_that_resets_its_connection_is_no_traceback(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with closing(open_link(f"udp:127.0.0.1:{free_port()}")) as link, bound(0) as listening:
        session = Session(Recording([link], tmp_path / "a.tlog"), [])
        server = _Server(Key(listening.getsockname()[1]), session)
        server.socket.close()
        server.socket = listening
        browser = socket.create_connection(listening.getsockname())
        accepted = server.get_request()
        browser.sendall(b"GET / HTTP/1.1\r\n")
        browser.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        browser.close()
        server.process_request_thread(*accepted)
    assert capsys.readouterr().err == ""


@needs_browser
@pytest.mark.parametrize("module", ["flysid", "tests.bare_flysid"])
def test_a_vehicle_is_seen_beside_its_model_and_recorded(
    place: Path, tmp_path: Path, browser: Any, module: str
) -> None:
    """Its forward speed goes wrong in flight: the page shows it, says it, and the file holds all of it."""
    if module == "flysid":
        pytest.importorskip("starlette", reason='the studio is not installed: pip install "flysid[studio]"')
    port = free_port()
    target = tmp_path / "flight.tlog"
    words = ("--live", f"udp:127.0.0.1:{port}", "--watch", str(place / "run"), "-o", str(target))
    with studio(tmp_path / "data", *words, module=module) as server:
        page = Page(browser, server)
        until(lambda: "nothing has come" in page.find("main").text)
        threading.Thread(target=play, args=(place / "bad.tlog", port, SPEED), daemon=True).start()
        until(lambda: len(page.js(STATE)["rows"]) > 300)
        page.js("document.querySelector('.chart').focus()")
        before = page.js(STATE)
        page.find(".chart").send_keys("+")  # shorter, and still following
        nearer = page.js(STATE)
        assert nearer["span"] < before["span"]
        assert nearer["end"] is None
        page.find(".chart").send_keys(" ")
        assert page.js(STATE)["end"] is not None
        assert "Paused" in page.find("button[aria-pressed]").text
        page.find("button[aria-pressed]").click()
        assert page.js(STATE)["end"] is None
        alarm = until(lambda: [e.text for e in page.all("li.alarm")], 60.0)[-1]
        assert 12.0 + FAULT_S <= float(alarm.split()[1]) < 12.0 + FAULT_S + 3.0
        assert "v_x <- theta_in left its band" in alarm
        times = np.array([row[0] for row in page.js(STATE)["rows"]])
        assert (np.diff(times) > 0.0).all()
        until(
            lambda: np.mean([row[3] is not None for row in page.js(STATE)["rows"]]) > 0.5
        )  # once 10 s have come
        assert page.js("return document.documentElement.scrollWidth <= innerWidth")
        assert not page.barriers_at_any_size()
        assert not [e for e in browser.get_log("browser") if e["level"] == "SEVERE"]
    content = target.read_bytes()
    assert whole_records(content, len(content))[0] == len(content)
    state = json.loads(target.with_name("flight.tlog.json").read_text())
    assert state["state"] == "closed"
    assert state["frames"] > 1000


@needs_browser
def test_what_goes_wrong_on_a_link_is_a_state_on_the_page_and_in_the_sidecar(
    place: Path, tmp_path: Path, browser: Any
) -> None:
    """Nothing, garbage, ten systems without the streams of the model, clocks that step, silence."""
    port = free_port()
    target = tmp_path / "flight.tlog"
    session = open_session((f"udp:127.0.0.1:{port}",), place / "run", 0.1, target)
    sent = 0
    garbage = random.Random(4).randbytes(1_200).replace(b"\xfd", b"\x00").replace(b"\xfe", b"\x00")
    with served(session, tmp_path) as server, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:

        def send(*frames: bytes) -> None:
            for frame in frames:
                out.sendto(frame, ("127.0.0.1", port))

        def said(words: str) -> None:
            until(lambda: words in page.find("main").text)

        page = Page(browser, server)
        session.start()
        said("nothing has come")
        for _ in range(GARBAGE):
            send(garbage)
        said("bytes that are no frame")
        vehicles = [common.MAVLink(None, srcSystem=k + 1, srcComponent=1) for k in range(10)]
        for _ in range(3):
            send(*[stepped(one, one.heartbeat_encode(2, 3, 0, 0, 4)) for one in vehicles])
            sent += 10
        until(lambda: len(page.all("tbody tr")) == 10)
        said("no stream for theta_in has come")
        for boot_ms in (10_000, 70_000, 500):  # a minute on, and from the beginning
            send(stepped(vehicles[0], vehicles[0].system_time_encode(0, boot_ms)))
            sent += 1
        said("system 1.1 set its clock")
        said("system 1.1 was started anew")
        session.recording.receiver._offset_s -= 30.0  # as if the host's clock had been set
        said("the clock of this host was set by +30 s")
        said("silent for")
        assert not page.barriers_at_any_size()
        assert not [e for e in browser.get_log("browser") if e["level"] == "SEVERE"]
    session.stop()
    content = target.read_bytes()
    assert whole_records(content, len(content)) == (len(content), sent)
    kept = json.loads(target.with_name("flight.tlog.json").read_text())
    [link] = kept["links"]
    assert link["silent_s"] > 5.0
    assert sum(peer["bytes_that_are_no_frame"] for peer in link["peers"]) == GARBAGE * len(garbage)
    assert len(link["peers"][0]["systems"]) == 10
    first = link["peers"][0]["systems"][0]
    assert (first["clock_steps"], first["boots"]) == (1, 1)
    assert [step["step_s"] for step in kept["host_clock_steps"]] == [pytest.approx(30.0, abs=0.5)]
    assert "no stream for theta_in has come" in kept["channels"]["longitudinal"]
    assert any("silent since" in text for text in kept["warnings"])


def stepped(link: Any, message: Any) -> bytes:
    """A frame; the next has the next number."""
    frame = bytes(message.pack(link))
    link.seq = (link.seq + 1) % 256
    return frame


@contextmanager
def served(session: Session, place: Path) -> Iterator[Server]:
    """The live page by itself; its thread ends before the socket: else it polls a closed one for ever."""
    with bound(0) as listening:
        key = Key(listening.getsockname()[1])
        server = _Server(key, session)
        server.socket.close()
        server.socket = listening
        serving = threading.Thread(target=server.serve_forever, args=(0.05,))
        serving.start()
        try:
            yield Server(place, f"{key.address}#/live", None)  # type: ignore[arg-type]
        finally:
            server.leaving.set()
            server.shutdown()
            serving.join()


def test_a_port_in_use_is_told_before_anything_begins(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        link = f"udp:127.0.0.1:{other.getsockname()[1]}"
        ended = call("studio", "data", "--no-open", "--live", link, cwd=tmp_path)
    assert ended.returncode == 2
    assert link in ended.stderr
    assert "in use" in ended.stderr
    assert not list(tmp_path.glob("data.studio/recordings/*"))
