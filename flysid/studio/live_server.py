"""The live page by itself, with Python alone: where the studio's packages are not installed.

The same page, the same events and the same checks of who asks; nothing but reading, no other page.
"""

from __future__ import annotations

import json
import sys
import threading
import time
import webbrowser
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from typing import Any
from urllib.parse import parse_qs, urlsplit

from flysid.studio.live_stream import EVERY_S, Live, event_text, seen_by
from flysid.studio.loopback import HEAD_S, HEADERS, HOST, POLICY, UNKNOWN, Key, bound, refusal

FILES = {
    "/": ("studio", "live.html", "text/html; charset=utf-8"),
    "/icon.svg": ("studio", "icon.svg", "image/svg+xml"),
    "/studio.css": ("studio", "studio.css", "text/css"),
    "/shared/uPlot.min.css": ("validate.show.page", "uPlot.min.css", "text/css"),
    "/shared/uPlot.iife.min.js": ("validate.show.page", "uPlot.iife.min.js", "text/javascript"),
    **{
        f"/{name}.js": ("studio", f"{name}.js", "text/javascript")
        for name in ("live_alone", "live", "api", "page", "plots")
    },
}


class _Server(ThreadingHTTPServer):
    """Serves until it is shut down; its threads end with it."""

    daemon_threads = True

    def __init__(self, key: Key, live: Live) -> None:
        super().__init__((HOST, key.port), _Handler, bind_and_activate=False)
        self.key = key
        self.live = live
        self.leaving = threading.Event()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that goes is not an error; anything else is printed with its traceback."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    """One request."""

    server: _Server
    protocol_version = "HTTP/1.1"
    timeout = HEAD_S

    def do_GET(self) -> None:
        """Answer a request."""
        key = self.server.key
        refused = refusal(key, {name.lower(): value for name, value in self.headers.items()})
        if refused is not None:
            self._answer(refused[0], "text/plain", refused[1].encode())
            return
        asked = urlsplit(self.path)
        offered = parse_qs(asked.query).get("token", [""])[0]
        if offered and asked.path == "/" and key.fits(offered):
            cookie = f"{key.cookie}={key.token}; HttpOnly; SameSite=strict; Path=/"
            self._answer(303, "text/plain", b"", {"Location": "/", "Set-Cookie": cookie})
        elif not key.is_known(self.headers.get("cookie", "")):
            self._answer(401, "text/plain", UNKNOWN.encode())
        elif asked.path == "/api/1/live":
            self._answer(200, "application/json", json.dumps(self.server.live.describe()).encode())
        elif asked.path == "/api/1/live/events":
            self._stream()
        elif asked.path in FILES:
            room, name, kind = FILES[asked.path]
            self._answer(200, kind, (resources.files(f"flysid.{room}") / "assets" / name).read_bytes())
        else:
            self._answer(404, "text/plain", b"there is only the live page here\n")

    def _answer(self, status: int, kind: str, body: bytes, more: dict[str, str] | None = None) -> None:
        self.send_response(status)
        self._head(kind, {"Content-Length": str(len(body)), **(more or {})})
        self.wfile.write(body)

    def _head(self, kind: str, more: dict[str, str]) -> None:
        for name, value in {
            "Content-Type": kind,
            "Content-Security-Policy": POLICY,
            **HEADERS,
            **more,
        }.items():
            self.send_header(name, value)
        self.end_headers()

    def _stream(self) -> None:
        """Events until the browser goes, or the server."""
        self.send_response(200)
        self._head("text/event-stream", {"Connection": "close"})
        self.close_connection = True
        seen: Mapping[str, int] = seen_by(self.headers.get("last-event-id", "{}"))
        step = 0
        try:
            while not self.server.leaving.is_set():
                text, seen = event_text(self.server.live, seen, step)
                self.wfile.write(text.encode())
                step += 1
                time.sleep(EVERY_S)
        except OSError:
            return  # the browser went

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Requests are not listed."""


def serve_live(live: Live, port: int, ready: Callable[[str], None], *, show: bool) -> None:
    """Serve the live page until interrupted.

    `port`: 0 takes a free one.
    `ready`: receives the address with the token, once the server answers.
    `show`: open it in the browser.
    Raises UsageError: the port is in use.
    """
    with bound(port) as listening:
        key = Key(listening.getsockname()[1])
        server = _Server(key, live)
        server.socket.close()
        server.socket = listening
        address = f"{key.address}#/live"
        ready(address)
        if show:
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
        try:
            server.serve_forever(poll_interval=0.2)
        finally:
            server.leaving.set()
