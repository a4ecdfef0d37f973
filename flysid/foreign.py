"""Paths that stand in documents: runs, manifests, models, lists of jobs. A document may be a stranger's.

Whatever joins a folder and a name out of a document does it here: no document leads out of its folder.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path, PurePosixPath, PureWindowsPath

from flysid.errors import StoreError


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
