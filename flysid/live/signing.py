"""Signed MAVLink 2: which frames are accepted.

    signature   link id u8, time u48 (10 us since 2015), first 6 bytes of SHA-256(key, frame up to here)

The hash is judged first, then the time, and only then is the time remembered: whoever remembers the time of a
frame that nobody signed can be shut out from the genuine stream for good, by one forged frame.
Source: https://mavlink.io/en/guide/message_signing.html
"""

from __future__ import annotations

import hashlib
import hmac
import os
import stat
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from flysid.errors import UsageError
from flysid.ingest.formats.mavlink.frames import SIGNATURE_BYTES, V2, MessageId, read_header
from flysid.live.batches import ByteArray, IntArray

KEY_BYTES = 32
KEY_VARIABLE = "FLYSID_SIGNING_KEY"
STREAM_BEHIND = 6_000_000  # a new stream may be a minute behind the newest, in 10 us

UNSIGNED = "unsigned"
WRONG_HASH = "wrong signature"
OLD = "old time"
Stream = tuple[int, int, int]


def load_key(path: Path | None) -> bytes | None:
    """The key in a file that only its owner can read, or in the environment; None where there is neither.

    A key is 32 bytes, or 64 hexadecimal digits; any other text is a pass phrase, whose SHA-256 is the key, as
    ground stations do. Raises UsageError: the file cannot be read, or others can.
    """
    if path is None:
        text = os.environ.get(KEY_VARIABLE)
        return _key(text.encode()) if text else None
    try:
        mode = path.stat().st_mode
        content = path.read_bytes()
    except OSError as error:
        raise UsageError(f"the key cannot be read: {error.strerror}", path=path) from error
    if os.name == "posix" and mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise UsageError("others can read the key", path=path, hint=f"chmod 600 {path}")
    if not content.strip():
        raise UsageError(
            "the file of the key is empty", path=path, hint="32 bytes, 64 hex digits or a phrase"
        )
    return _key(content)


def _key(content: bytes) -> bytes:
    if len(content) == KEY_BYTES:
        return content
    text = content.strip()
    try:
        digits = bytes.fromhex(text.decode("ascii"))
    except ValueError:
        digits = b""
    return digits if len(digits) == KEY_BYTES else hashlib.sha256(text).digest()


@dataclass
class Guard:
    """Judges the frames of all links by one key.

    `key`: 32 bytes.
    `unsigned`: what becomes of frames without a signature: "reject", "keep", or "radio": keep RADIO_STATUS
        alone, which radios put in without knowing the key.
    `refused`: (peer, reason) -> frames.
    """

    key: bytes
    unsigned: str = "reject"
    refused: Counter[tuple[int, str]] = field(default_factory=Counter)
    _last: dict[Stream, int] = field(default_factory=dict)
    _newest: int = 0

    def accepted(self, peer: int, raw: ByteArray, starts: IntArray) -> npt.NDArray[np.bool_]:
        """(n,) which of the frames at `starts` are accepted."""
        content = raw.tobytes()
        reasons = [self._reason(content, q) for q in starts.tolist()]
        self.refused.update((peer, reason) for reason in reasons if reason)
        return np.array([not reason for reason in reasons], np.bool_)

    def _reason(self, content: bytes, q: int) -> str:
        """Why the frame at q is refused; "" where it is not."""
        head = read_header(content, q)
        assert head is not None
        if content[q] != V2 or not content[q + 2]:
            kept = self.unsigned == "keep" or (
                self.unsigned == "radio" and head.message == MessageId.RADIO_STATUS
            )
            return "" if kept else UNSIGNED
        signature = head.end - SIGNATURE_BYTES
        digest = hashlib.sha256(self.key + content[q : signature + 7]).digest()[:6]
        if not hmac.compare_digest(digest, content[signature + 7 : head.end]):
            return WRONG_HASH
        time = int.from_bytes(content[signature + 1 : signature + 7], "little")
        stream = (content[signature], content[q + 5], content[q + 6])
        last = self._last.get(stream)
        if time <= (self._newest - STREAM_BEHIND if last is None else last):
            return OLD
        self._last[stream] = time
        self._newest = max(self._newest, time)
        return ""
