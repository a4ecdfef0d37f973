"""Documents that may be a stranger's: runs, manifests, models, vehicles, designs, lists of jobs.

Whatever joins a folder and a name out of a document does it here: no document leads out of its folder. What
a document of flysid's holds is read, and brought into the types that it is meant for, here as well.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, TypeVar

import msgspec

from flysid.errors import StoreError
from flysid.files import remedy_unread, why_unread

T = TypeVar("T")
LARGEST_BYTES = 256 << 20
"""Of a document; a model with all of its rules takes a thousandth of it."""


def inner_path(folder: Path, name: object, document: str | Path) -> Path:
    """`folder / name`, known to lie in `folder`, and to be a file, a folder, or nothing yet.

    Parameters
    ----------
    folder : what the name must not leave. It may itself be a link: the user has chosen it.
    name : the entry of the document.
    document : the file that holds the entry; the error names it.

    Raises
    ------
    StoreError : the name is no text, empty, absolute or a drive, climbs up, follows a link that leaves the
        folder, or names a device, a pipe or a socket.
    """
    reason = why_outside(name)
    if not reason:
        path = folder / str(name)
        try:
            reason = _why_not_inside(path, folder)
        except (OSError, ValueError, RuntimeError) as error:  # too long, a zero byte, links in a circle
            reason = f"is no path: {getattr(error, 'strerror', None) or error}"
    if reason:
        raise StoreError(
            f"the entry {str(name)[:200]!r} {reason}",
            path=document,
            hint="do not use this file: no flysid writes such an entry",
        )
    return path


def why_outside(name: object) -> str:
    """Why a name by itself cannot be that of a file below a folder; "" where it can."""
    if not isinstance(name, str) or not name:
        return "is no file name"
    if "://" in name:
        return "is an address, not a file below the folder"
    forms = (PurePosixPath(name), PureWindowsPath(name))
    if any(form.anchor for form in forms) or name.startswith("~"):
        return "is an absolute path, not one below the folder"
    if any(".." in form.parts for form in forms):
        return "leads out of the folder"
    return ""


def _why_not_inside(path: Path, folder: Path) -> str:
    real = os.path.realpath(path)
    home = os.path.realpath(folder)
    if os.path.commonpath([real, home]) != home:
        return "is a link that leads out of the folder"
    try:
        mode = os.stat(real).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return ""
    return "" if stat.S_ISREG(mode) or stat.S_ISDIR(mode) else "is a device, a pipe or a socket"


def read_object(path: Path, what: str, hint: str) -> dict[str, Any]:
    """The JSON object in a file.

    `what`: it is, for the words of an error: "a flysid model".
    `hint`: what to try where it is none.
    Raises StoreError: it cannot be read, is no file or too large, is not JSON (which has neither NaN nor
    infinity), or no object.
    """
    try:
        mode = path.stat()
        if stat.S_ISREG(mode.st_mode) and mode.st_size <= LARGEST_BYTES:
            return msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
        fault = f": {mode.st_size:,} bytes" if stat.S_ISREG(mode.st_mode) else ": no file"
    except OSError as error:
        raise StoreError(
            f"cannot be read: {why_unread(error)}", path=path, hint=remedy_unread(error)
        ) from error
    except msgspec.ValidationError:
        fault = ""
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        fault = ": not JSON"
    raise StoreError(f"not {what}{fault}", path=path, hint=hint)


def shaped(body: object, shape: type[T]) -> T:
    """What was read as JSON as the type that it is meant for, lists as tuples, every entry checked.

    Raises ValueError: an entry is missing or of another type; says which.

    >>> shaped([1, 2.5], tuple[float, ...])
    (1.0, 2.5)
    """
    try:
        return msgspec.convert(body, shape)
    except (msgspec.ValidationError, OverflowError, RecursionError) as error:
        raise ValueError(str(error)) from error
