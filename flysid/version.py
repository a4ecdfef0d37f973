"""The version of flysid, as files that it writes record it; and what a file of another version means."""

from __future__ import annotations

from pathlib import Path

from flysid.errors import StoreError

__version__ = "0.1.0"


def check_version(stated: object, newest: int, what: str, path: str | Path) -> int:
    """The format version that a file states, once it is known to be one that this flysid reads.

    Every version from 1 to `newest` is read. Raises StoreError: newer (names the upgrade), or no version at
    all.
    """
    if not isinstance(stated, int) or isinstance(stated, bool) or stated < 1:
        raise StoreError(f"damaged {what}: version {stated!r}", path=path, hint="make it again")
    if stated > newest:
        raise StoreError(
            f"{what} of version {stated}, written by a newer flysid; this one reads up to {newest}",
            path=path,
            hint="upgrade with: pip install --upgrade flysid",
        )
    return stated
