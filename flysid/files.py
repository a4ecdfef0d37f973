"""Files and folders that are there whole or not at all, also after a power cut; one writer at a time."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from flysid.errors import StoreError, WriteError

# `f_type` of file systems whose syncfs(2) waits for what their fsync(2) waits for. Others may not: FUSE does
# not pass it on to the program behind it.
_SYNCED_WHOLE = {
    "ext": 0xEF53,
    "xfs": 0x58465342,
    "btrfs": 0x9123683E,
    "f2fs": 0xF2F52010,
    "tmpfs": 0x01021994,
}
_RESERVED = {"con", "prn", "aux", "nul", *(f"{d}{i}" for d in ("com", "lpt") for i in range(10))}
_HERE = -100  # AT_FDCWD: paths are relative to the working folder
_EXCHANGE = 2  # RENAME_EXCHANGE


def slug(name: str, taken: Collection[str] = ()) -> str:
    """A file name for `name` that is safe on every file system and differs from all `taken` (folded) names.

    Letters, digits, '.', '_' and '-' stay, all else becomes '_'. A name that is too long, reserved, begins
    with a dot, or clashes when case is ignored gets a hash of the full name.
    """
    safe = re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("_.")[:80] or "stream"
    if safe.split(".")[0].lower() not in _RESERVED and safe.casefold() not in taken and len(name) <= 80:
        return safe
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()
    return (
        f"{safe}-{digest[:12]}" if safe.split(".")[0].lower() not in _RESERVED else f"s-{safe}-{digest[:12]}"
    )


def why_unread(error: OSError | ValueError) -> str:
    """Why a text file could not be read, without its path, which an error names beside it."""
    if isinstance(error, UnicodeDecodeError):
        return "not a text file in UTF-8"
    number = getattr(error, "errno", None)
    return os.strerror(number) if number else str(error)  # Arrow's own words repeat path and number


def remedy_unread(error: OSError | ValueError) -> str:
    """What to try where a file could not be read."""
    if isinstance(error, UnicodeDecodeError):
        return "save it as UTF-8"
    number = getattr(error, "errno", None)
    if number in (errno.ENOENT, errno.ENOTDIR):
        return "check its name and folder"
    if number in (errno.EACCES, errno.EPERM):
        return "make it readable for this user"
    return "give a file" if number == errno.EISDIR else "copy it again, from a sound medium"


def unread_table(error: Exception, path: str | Path, otherwise: str) -> StoreError:
    """A stored table that the system refuses to read; or that is damaged, for which `otherwise` helps."""
    if isinstance(error, OSError) and error.errno is not None and error.errno != errno.ENOENT:
        return StoreError(f"cannot be read: {error.strerror}", path=path, hint=remedy_unread(error))
    return StoreError(f"damaged or missing: {error}", path=path, hint=otherwise)


@contextmanager
def writing_to(path: Path) -> Iterator[None]:
    """Turn the system's refusal to write into a WriteError that names the path."""
    try:
        yield
    except MemoryError:  # Arrow's is an ArrowException too; the folder is not at fault
        raise
    except _refusals() as error:
        reason = getattr(error, "strerror", None) or re.sub(r"^.*\[errno \d+\] ", "", str(error))  # Arrow's
        raise WriteError(f"cannot be written: {reason}", path=path, hint=_remedy(error)) from error


def check_place(path: Path, *, makes_folders: bool = True) -> None:
    """Raise WriteError where nothing can be written to `path`: tried, not read off permissions.

    `makes_folders`: whether the folders on the way to it are made; the nearest one that is there is tried.
    """
    place = path.absolute().parent
    while makes_folders and not place.exists() and place != place.parent:
        place = place.parent
    with writing_to(path), tempfile.TemporaryFile(dir=place):
        pass


_REMEDIES: Mapping[int, str] = {
    errno.ENOENT: "make the folder that it is to be in first",
    errno.EEXIST: "a file is in the way of a folder: remove it, or choose another name",
    errno.EISDIR: "a folder is in the way of a file: choose another name",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOSPC: "free space or choose another folder",
    errno.EDQUOT: "free some of your own space (quota), or choose another folder",
    errno.EFBIG: "choose a folder on a file system that takes larger files",
    errno.EMFILE: "allow more open files: ulimit -n 4096",
    errno.ENFILE: "close other programs: the system has too many files open",
    errno.EIO: "look after that disk: it failed; choose another one",
}


def _remedy(error: Exception) -> str:
    """What to try where the system refuses to write: by its reason, not by its kind."""
    return _REMEDIES.get(getattr(error, "errno", None) or 0, "choose another folder")


def _refusals() -> tuple[type[Exception], ...]:
    """What the system's refusal is raised as; Arrow's own kind where Arrow is in use."""
    arrow = sys.modules.get("pyarrow")
    return (OSError,) if arrow is None else (OSError, arrow.ArrowException)


@contextmanager
def locked(lock: Path, target: Path, *, keep: bool = True) -> Iterator[None]:
    """Hold a lock, so that no two processes write to `target` at once.

    The system releases the lock when the process ends, however it ends.

    `lock`: the lock's file; made where it is not there.
    `target`: what is written to; errors name it.
    `keep`: leave the lock's file; without it, the file goes with the lock.
    Raises WriteError: another process holds it, or its file cannot be made.
    """
    import filelock

    held = filelock.FileLock(lock, blocking=False)
    with writing_to(target):
        try:
            held.acquire()
        except filelock.Timeout as error:
            if not lock.exists():  # a folder in which no file can be made counts as taken, too
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT)) from error
            raise WriteError(
                "another flysid is writing to this place", path=target, hint="wait until it has finished"
            ) from error
    try:
        yield
    finally:
        if not keep:
            with suppress(OSError):  # Windows removes it when it is released
                lock.unlink()  # still held: whoever opened it before notices that it has no name any more
        held.release()


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file that appears whole or not at all (temporary file, fsync, rename). Raises OSError."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.unlink(missing_ok=True)  # a link there is not followed
        with temporary.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    sync(path.parent)


_LEFT = re.compile(r"\..*[.-](?P<pid>\d+)(-[a-z0-9_]{8})?")
"""Names that writers use meanwhile: hidden, with the number of their process, and letters by chance."""


def remove_left_behind(folder: Path, beginning: str) -> int:
    """Remove files and folders that a writer on this machine left when it was killed; returns how many.

    `beginning`: of their names, with the dot. What a process that still runs is at work on stays.
    """
    removed = 0
    with suppress(OSError):
        for path in folder.iterdir():
            left = _LEFT.fullmatch(path.name)
            if left and path.name.startswith(beginning) and not runs(int(left["pid"])):
                _remove(path)
                removed += 1
    return removed


def runs(pid: int) -> bool:
    """Whether a process of this machine runs; where that cannot be known, yes."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


@contextmanager
def replacing_folder(out: Path) -> Iterator[Path]:
    """A new folder beside `out` that takes its place when the block ends well, and vanishes otherwise.

    Raises WriteError where another process is about to replace `out`, or nothing can be written there.
    """
    with writing_to(out):
        out.parent.mkdir(parents=True, exist_ok=True)
    with _making(out) as incoming:
        with writing_to(incoming):
            incoming.mkdir()
        yield incoming
        with writing_to(out):
            put_in_place(incoming, out)


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """A hidden name beside `path` for a file that becomes `path` when the block ends well; raises as
    `replacing_folder`.
    """
    with _making(path) as incoming:
        yield incoming
        with writing_to(path):
            sync(incoming)
            incoming.replace(path)
            sync(path.parent)


@contextmanager
def _making(out: Path) -> Iterator[Path]:
    """A hidden name beside `out`, for this process alone; nothing is there before, and nothing afterwards."""
    incoming = out.with_name(f".{out.name}.incoming")
    with locked(out.with_name(f".{out.name}.lock"), out, keep=False):
        _remove(incoming)
        try:
            yield incoming
        finally:
            _remove(incoming)


def _remove(path: Path) -> None:
    """Remove a folder, or a file, if it is there."""
    shutil.rmtree(path, ignore_errors=True)
    with suppress(OSError):
        path.unlink()


def put_in_place(incoming: Path, final: Path) -> None:
    """Make `incoming` (a folder) be `final`; a folder that is there is replaced and removed. Raises OSError.

    Where the system can exchange two names (Linux), there is no moment without a `final`.
    """
    if not final.exists():
        incoming.rename(final)
    elif exchange(incoming, final):
        shutil.rmtree(incoming, ignore_errors=True)
    else:
        old = final.with_name(f".{final.name}.replaced.{os.getpid()}")
        final.rename(old)
        incoming.rename(final)
        shutil.rmtree(old, ignore_errors=True)
    sync(final.parent)


def exchange(one: Path, other: Path) -> bool:
    """Swap two names at once (renameat2, RENAME_EXCHANGE); False where the system cannot."""
    import ctypes

    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError, TypeError):
        return False
    return bool(renameat2(_HERE, os.fsencode(one), _HERE, os.fsencode(other), _EXCHANGE) == 0)


def sync(path: Path) -> None:
    """Flush a file or folder to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def filling(folder: Path) -> Iterator[None]:
    """When the block ends well, the files in a folder are on the disk, and their names; else WriteError.

    The file system is flushed as a whole where that is known to do (one wait instead of one per file), else
    every file by itself.
    """
    with writing_to(folder):
        handle = os.open(folder, os.O_RDONLY) if syncs_whole(folder) else None
    try:  # opened before anything is written: it learns of every failure from then on
        yield
        with writing_to(folder):
            if handle is not None:
                sync_file_system(handle)
            else:
                for path in (*folder.iterdir(), folder):
                    sync(path)
    finally:
        if handle is not None:
            os.close(handle)


def syncs_whole(folder: Path) -> bool:
    """Whether one syncfs(2) does what fsync(2) of every file would: on some file systems, since Linux 5.8.

    Older kernels do not say when something could not be written.
    """
    import ctypes

    if not hasattr(os, "uname") or os.uname().sysname != "Linux":
        return False
    kernel = [int(n) for n in re.findall(r"\d+", os.uname().release)[:2]]
    answer = ctypes.create_string_buffer(
        512
    )  # a struct statfs is 64 to 120 bytes; its first word is the type
    done = ctypes.CDLL(None, use_errno=True).statfs(os.fsencode(folder), answer)
    kind = ctypes.c_ulong.from_buffer(answer).value
    return kernel >= [5, 8] and done == 0 and kind in _SYNCED_WHOLE.values()


def sync_file_system(handle: int) -> None:
    """Flush the file system that an open file or folder is on. Raises OSError."""
    import ctypes

    libc = ctypes.CDLL(None, use_errno=True)
    if libc.syncfs(handle):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
