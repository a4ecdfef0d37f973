"""Fits that several ask for are done once: the baseline, its rivals and the rules start from the same.

Within `sharing()` a fit is remembered by its settings and by what its data hold, not by which objects they
are.
"""

from __future__ import annotations

import hashlib
from collections.abc import Hashable

import numpy as np

from flysid.dataset import Dataset
from flysid.sharing import Itself as Itself
from flysid.sharing import once as once
from flysid.sharing import sharing as sharing


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
