"""Proof that this user made a job: a folder of data may come from a stranger, with the jobs beside it.

A job that waits is a command that the next studio runs. Each carries a seal by a key that lies with the
user's own state, not with the data; a studio runs no other.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
from collections.abc import Mapping
from pathlib import Path

import msgspec

KEY_BYTES = 32


def state_folder(environment: Mapping[str, str]) -> Path:
    """Where flysid keeps what is the user's alone. A relative XDG_STATE_HOME is void, as it is to be."""
    base = Path(environment.get("XDG_STATE_HOME", ""))
    return (base if base.is_absolute() else Path.home() / ".local" / "state") / "flysid"


def own_key(folder: Path) -> bytes:
    """The user's key, made at its first use; one for this process where none can be kept."""
    path = folder / "studio.key"
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        return _kept(path) or secrets.token_bytes(KEY_BYTES)
    except OSError:
        return secrets.token_bytes(KEY_BYTES)
    with os.fdopen(handle, "wb") as file:
        key = secrets.token_bytes(KEY_BYTES)
        file.write(key)
    return key


def sealed(key: bytes, place: str, *parts: object) -> str:
    """The seal of a job's parts, in the folder that it lies in."""
    return hmac.new(key, msgspec.json.encode([place, *parts]), hashlib.sha256).hexdigest()


def _kept(path: Path) -> bytes:
    """A key that was kept whole; empty where it was not."""
    try:
        key = path.read_bytes()
    except OSError:
        return b""
    return key if len(key) == KEY_BYTES else b""
