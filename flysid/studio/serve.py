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

import uvicorn

from flysid.studio.app import make_app
from flysid.studio.folders import VIEWS, Workspace
from flysid.studio.impatient import Impatient
from flysid.studio.live_stream import Live
from flysid.studio.loopback import Key, bound


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
