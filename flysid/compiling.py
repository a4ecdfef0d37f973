"""Functions that Numba compiles, and keeps on disk for the processes after.

Before Numba loads what it has kept, it fills its tables of all that could be compiled, which takes a fifth of
a second in every process. Kept code needs the runtime alone, and the tables are filled where something is
compiled after all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher
from numba.core.runtime.nrt import rtsys

F = TypeVar("F", bound=Callable[..., object])
TRIED = ("0.68.",)
"""Versions of Numba with which kept code was run beside the runtime alone; others load in their own way."""


class _Kept(FunctionCache):
    def load_overload(self, sig: Any, target_context: Any) -> Any:
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]


def njit(*, cache: bool, **settings: Any) -> Callable[[F], Dispatcher[F]]:
    """`numba.njit`, whose kept code is loaded sooner.

    Parameters
    ----------
    cache : keep the code on disk.
    settings : as `numba.njit` takes them.

    Examples
    --------
    >>> from flysid.compiling import njit
    >>> @njit(cache=False)
    ... def twice(x):
    ...     return 2.0 * x
    >>> twice(1.5)
    3.0
    """
    if not (cache and numba.__version__.startswith(TRIED)):
        plain: Callable[[F], Dispatcher[F]] = numba.njit(cache=cache, **settings)
        return plain

    def compile_kept(function: F) -> Dispatcher[F]:
        dispatcher: Dispatcher[F] = numba.njit(**settings)(function)
        dispatcher._cache = _Kept(function)  # type: ignore[attr-defined, no-untyped-call]
        return dispatcher

    return compile_kept
