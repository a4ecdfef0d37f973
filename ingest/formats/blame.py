"""What goes wrong with a file, as an error of that file.

Readers refuse what they know to be wrong. What they do not foresee ends in an exception of Python or of a
library: an index out of range, a name that is there twice. It is that file's error, not a batch's end.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from flysid.errors import FlysidError, FormatError


def blamed(error: Exception, path: str | Path | None = None) -> FormatError:
    """The error of a file that made a reader stop with `error`; flysid's own errors keep their words."""
    if isinstance(error, FlysidError):
        return FormatError(error.message, hint=error.hint, path=error.path or path, byte=error.byte)
    if isinstance(error, OSError) and error.strerror:
        return FormatError(f"cannot be read: {error.strerror}", path=path)
    said = (str(error).splitlines() or [""])[0].strip()
    what = f"{type(error).__name__}: {said}" if said else type(error).__name__
    return FormatError(
        f"damaged or hostile: its reader stopped with {what}",
        path=path,
        hint="copy it again; where it is sound, please report it",
    )


@contextmanager
def blaming(path: str | Path | None = None) -> Iterator[None]:
    """Turn what the block raises without intent into a FormatError.

    flysid's own errors and MemoryError pass: the first state their cause, the second may be the machine's.
    """
    try:
        yield
    except (FlysidError, MemoryError):
        raise
    except Exception as error:
        raise blamed(error, path) from error
