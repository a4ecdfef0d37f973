"""What a copy as text does to a binary log, seen in its bytes."""

from __future__ import annotations

ENOUGH = 8
"""Coincidences that are none: in binary data one such is as likely as 1 in 256."""
REPLACED = "\ufffd".encode()
_TEXT_MARKS = (b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf")
_NOT_IN_TEXT = bytes(set(range(32)) - set(b"\a\b\t\n\v\f\r\x1b"))


def is_text(head: bytes) -> bool:
    """Whether these bytes are text: no control characters but those of texts, or a mark of Unicode."""
    return head.startswith(_TEXT_MARKS) or head.translate(None, _NOT_IN_TEXT) == head


def text_mode_at(head: bytes) -> int:
    """Where a copy as text first put a carriage return into binary data; -1 where none was made.

    Such a copy leaves no line feed alone.
    """
    lines = head.count(b"\n")
    is_changed = lines >= ENOUGH and lines == head.count(b"\r\n") and not is_text(head)
    return head.index(b"\r\n") if is_changed else -1


def harm_of(head: bytes) -> str:
    """What a copy as text did to the binary log that begins so; "" where nothing tells of one."""
    at = text_mode_at(head)
    if at >= 0:
        return (
            f"it was copied as text, which put a byte 0D ahead of every 0A, first at byte {at}: "
            "copy it in binary mode"
        )
    if head.count(REPLACED) >= ENOUGH and not is_text(head):
        at = head.index(REPLACED)
        return f"it was saved as text, which replaced bytes, first at byte {at}: copy it again"
    return ""
