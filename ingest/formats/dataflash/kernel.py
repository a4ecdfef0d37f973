"""The rules of `rules`, compiled: a megabyte of garbage takes milliseconds, and a second in Python.

Imported only where much of a log has been lost: see `frames.COMPILE_AFTER`.
"""

from __future__ import annotations

from types import FunctionType
from typing import Any

from flysid.compiling import njit
from flysid.ingest.formats.dataflash import rules

IN_ORDER = (
    rules.is_mark,
    rules.length_at,
    rules.stated_ns,
    rules.next_ns,
    rules.could_define,
    rules.is_in_order,
    rules.is_impossible,
    rules.is_followed,
    rules.leads_on,
    rules.is_several,
    rules.is_message,
    rules.is_asked_about,
    rules.walk,
)
"""Each calls those before it alone."""


def compile_rules() -> Any:
    """`rules.walk` as machine code, kept on the disk by numba."""
    names: dict[str, Any] = dict(vars(rules))
    for plain in IN_ORDER:
        names[plain.__name__] = njit(cache=True, nogil=True)(
            FunctionType(plain.__code__, names, plain.__name__)
        )
    return names["walk"]


walk = compile_rules()
