"""Linear algebra on one thread: on small matrices threads only wait for each other."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController


@contextmanager
def one_thread() -> Iterator[None]:
    """The block, with BLAS limited to one thread; the caller's limits are restored."""
    with _controller().limit(limits=1):
        yield


@functools.cache
def _controller() -> ThreadpoolController:
    """NumPy's and SciPy's; found once: to look through all that is loaded takes longer than a small fit."""
    import scipy.linalg  # noqa: F401 - brings its own
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")
