"""Fits that several ask for are done once: the baseline, its rivals and the rules start from the same.

Within `sharing()` a fit is remembered by its settings and by what its data hold, not by which objects they
are; when the scope ends, all is forgotten.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar

import numpy as np

from flysid.dataset import Dataset

P = ParamSpec("P")
R = TypeVar("R")

_known: ContextVar[dict[Hashable, Any] | None] = ContextVar("fits", default=None)


@contextmanager
def sharing() -> Iterator[None]:
    """The scope in which fits are shared; a scope within a scope is part of it."""
    if _known.get() is not None:
        yield
        return
    token = _known.set({})
    try:
        yield
    finally:
        _known.reset(token)


def once(key: Callable[..., Hashable | None]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A function whose answer is remembered by `key` of its arguments; None: it is not."""

    def remembering(function: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(function)
        def asked(*args: P.args, **kwargs: P.kwargs) -> R:
            known = _known.get()
            at = None if known is None else key(*args, **kwargs)
            if known is None or at is None:
                return function(*args, **kwargs)
            whole = (function.__module__, function.__qualname__, at)
            if whole not in known:
                known[whole] = function(*args, **kwargs)
            answer: R = known[whole]
            return answer

        return asked

    return remembering


def fit_key(settings: object, train: object, validation: object = None) -> Hashable | None:
    """Settings and data of an estimator's fit; None for data on disk."""
    if not isinstance(train, Dataset):
        return None
    held = digest(validation) if isinstance(validation, Dataset) else None
    return type(settings).__name__, repr(settings), digest(train), held


def digest(data: Dataset) -> bytes:
    """Of all that a fit sees of a dataset."""
    found = hashlib.blake2b(repr((data.dt_s, data.inputs, data.outputs)).encode(), digest_size=16)
    for segment in data.segments:
        found.update(repr((segment.u.shape, segment.y.shape, segment.flight)).encode())
        found.update(np.ascontiguousarray(segment.u).data)
        found.update(np.ascontiguousarray(segment.y).data)
    return found.digest()
