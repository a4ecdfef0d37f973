"""Logs that are dropped on the page: streamed to a folder of their own, under a name that is safe."""

from __future__ import annotations

import shutil
import uuid
from collections.abc import AsyncIterator
from pathlib import Path

from flysid.errors import UsageError
from flysid.files import slug, writing_to
from flysid.foreign import inner_path
from flysid.studio.folders import NotThere, is_name


async def keep_upload(folder: Path, name: str, parts: AsyncIterator[bytes], length: int) -> Path:
    """Write what arrives into `folder`; the path of the file.

    Raises
    ------
    UsageError : no name, no bytes, or fewer than were announced. WriteError : the disk is full.
    """
    base = name.replace("\\", "/").rpartition("/")[2]
    if not base.strip(". "):
        raise UsageError("the log has no name", hint="uploads?name=flight.bin")
    if not length:
        raise UsageError(f"{base} is empty")
    stem, dot, suffix = base.rpartition(".")
    safe = f"{slug(stem)}.{slug(suffix)}" if dot and stem else slug(base)
    place = folder / uuid.uuid4().hex
    path = place / safe
    received = 0
    try:
        with writing_to(path):
            place.mkdir()
            with path.open("wb") as file:
                async for part in parts:
                    received += len(part)
                    file.write(part)
        if received != length:
            raise UsageError(f"{base}: {received:,} of {length:,} bytes arrived", hint="drop it again")
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise
    return path


def find_upload(folder: Path, name: str) -> Path:
    """The log of an upload; raises NotThere, and StoreError where it leads out of the folder."""
    found = list((folder / name).glob("*")) if is_name(name) else []
    found = [path for path in found if not path.name.startswith(".")]
    if not found:
        raise NotThere(f"no upload {name!r}")
    return inner_path(folder, f"{name}/{found[0].name}", folder)
