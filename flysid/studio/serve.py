"""The server on loopback: a port, a token, an address to open."""

from __future__ import annotations

import asyncio
import os
import threading
import webbrowser
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType
from typing import TYPE_CHECKING, Any

import uvicorn
from uvicorn.protocols.http.auto import AutoHTTPProtocol

from flysid.studio.app import make_app
from flysid.studio.folders import VIEWS, Workspace
from flysid.studio.live_stream import Live
from flysid.studio.loopback import HEAD_S, Key, bound

if TYPE_CHECKING:
    from uvicorn.protocols.http.h11_impl import H11Protocol as Http
else:
    Http = AutoHTTPProtocol


class Impatient(Http):
    """Closes a connection whose next request has not begun within `HEAD_S`; a body has bounds of its own.

    uvicorn bounds the time between two requests, but not the time that a request takes to arrive.
    """

    _closing: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._wait_for_head()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if self.cycle is None or self.cycle.response_complete:
            self._wait_for_head()
        else:
            self._stop_waiting()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_waiting()
        super().connection_lost(exc)

    def _wait_for_head(self) -> None:
        if self._closing is None:
            self._closing = self.loop.call_later(HEAD_S, self.transport.close)

    def _stop_waiting(self) -> None:
        if self._closing is not None:
            self._closing.cancel()
            self._closing = None


class Server(uvicorn.Server):
    """Ends with the first Ctrl-C, for it tells event streams that it does."""

    def __init__(self, config: uvicorn.Config, leaving: asyncio.Event) -> None:
        super().__init__(config)
        self._leaving = leaving

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        self._leaving.set()
        super().handle_exit(sig, frame)


def _views(workspace: Workspace) -> TemporaryDirectory[str]:
    """A folder for what is drawn; its name says whose it is, so that the next studio can remove it."""
    return TemporaryDirectory(dir=workspace.folder, prefix=f"{VIEWS}{os.getpid()}-")


def serve(
    workspace: Workspace, port: int, ready: Callable[[str], None], show: bool, live: Live | None = None
) -> None:
    """Serve until interrupted.

    `workspace`: its folders.
    `port`: 0 takes a free one.
    `ready`: receives the address with the token, once the server answers.
    `show`: open it in the browser.
    `live`: what is recorded and watched meanwhile; its page is opened first.
    """
    with bound(port) as listening, _views(workspace) as cache:
        key = Key(listening.getsockname()[1])
        leaving = asyncio.Event()
        app = make_app(workspace, key, Path(cache), leaving, live=live)
        address = key.address if live is None else f"{key.address}#/live"
        ready(address)
        if show:
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
        config = uvicorn.Config(
            app, http=Impatient, log_level="warning", access_log=False, server_header=False
        )
        Server(config, leaving).run(sockets=[listening])
