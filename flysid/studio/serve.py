"""The server on loopback: a port, a token, an address to open."""

from __future__ import annotations

import contextlib
import socket
import threading
import webbrowser
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import uvicorn

from flysid.errors import UsageError
from flysid.studio.app import make_app
from flysid.studio.guard import Key
from flysid.studio.places import Workspace

HOST = "127.0.0.1"


@contextlib.contextmanager
def bound(port: int) -> Iterator[socket.socket]:
    """A socket on loopback; `port` 0 takes any that is free.

    Raises
    ------
    UsageError : the port is in use, or not ours to take.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((HOST, port))
        except (OSError, OverflowError) as error:
            raise UsageError(
                f"port {port} cannot be used: {error}", hint="leave out --port: a free one is taken"
            ) from error
        listening.listen(128)
        yield listening


def serve(workspace: Workspace, port: int, ready: Callable[[str], None], show: bool) -> None:
    """Serve until interrupted.

    Parameters
    ----------
    workspace : its folders.
    port : 0 takes a free one.
    ready : is told the address with the token, when it answers.
    show : open it in the browser.
    """
    with bound(port) as listening, TemporaryDirectory(dir=workspace.folder, prefix=".views-") as cache:
        key = Key(listening.getsockname()[1])
        app = make_app(workspace, key, Path(cache))
        ready(key.address)
        if show:
            threading.Thread(target=webbrowser.open, args=(key.address,), daemon=True).start()
        config = uvicorn.Config(app, log_level="warning", access_log=False, server_header=False)
        uvicorn.Server(config).run(sockets=[listening])
