"""What holds while a model is fitted: a dataset, one BLAS thread, and numerical failures as FitError.

Sums of a threaded BLAS depend on the number of threads in their last bits, and a choice between orders or
rule counts can hang on those bits: fits would differ between machines. The matrices here are small, too; on
them threads cost time instead of saving it.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar

import numpy as np

from flysid.blas import one_thread
from flysid.errors import FitError, UsageError

LEARNT_FROM = 32 * 2**20 - 2**16
"""Bytes: glibc's M_MMAP_THRESHOLD grows up to 32 MiB, with what it adds to a block."""
_limited = ContextVar("limited", default=False)
P = ParamSpec("P")
R = TypeVar("R")


def on_one_thread(fit: Callable[P, R]) -> Callable[P, R]:
    """`fit`, run with BLAS limited to one thread; the caller's limits are restored.

    What it calls `train` or `data` must be a dataset: arrays are what people try first, and UsageError says
    how to make one of them.

    Where linear algebra fails for good it raises FitError, with what in the samples is the cause, if anything
    is: a caller never meets NumPy's own error. Trial models that diverge overflow on the way; the optimisers
    see that and step back, so it is no news.
    """

    named = list(inspect.signature(fit).parameters)
    of_data = [(at, name) for at, name in enumerate(named) if name in ("train", "data")]

    @functools.wraps(fit)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        given = [
            kwargs[name] if name in kwargs else args[at]
            for at, name in of_data
            if name in kwargs or at < len(args)
        ]
        for data in given:
            _refuse_arrays(data)
        _keep_freed_memory()
        within = _limited.get()
        limits = nullcontext() if within else one_thread()
        with limits, np.errstate(over="ignore", invalid="ignore"):
            token = _limited.set(True)
            try:
                return fit(*args, **kwargs)
            except np.linalg.LinAlgError as error:
                raise FitError(f"the numbers broke down: {error}", hint=_remedy(given)) from error
            finally:
                _limited.reset(token)

    return limited


@functools.cache
def _keep_freed_memory() -> None:
    """Have glibc's allocator keep what a fit frees, which asks for as much again at once.

    It gives free memory back beyond twice the largest block that was freed, and every page that is asked for
    again has to be cleared by the system. The block here is the largest that it learns from; nothing is
    written to it, so that it takes no memory. Other allocators learn nothing.
    """
    np.empty(LEARNT_FROM, dtype=np.uint8)


def _remedy(given: Sequence[Any]) -> str:
    """What to try where linear algebra failed: the samples are at fault only where they show why."""
    faults = [fault for data in given for fault in _faults(data)]
    if faults:
        return "; ".join(dict.fromkeys(faults))
    found = "the samples show no cause, so " if given else ""
    return f"{found}the fault is the computation's: choose another model (--models), and report the command"


def _faults(data: Any) -> Iterator[str]:
    """Signals that stand still, and inputs that are sums of others; nothing of data on disk."""
    segments = getattr(data, "segments", ())
    if not segments:
        return
    for side, signals in (("u", data.inputs), ("y", data.outputs)):
        spans = np.ptp(np.concatenate([getattr(s, side) for s in segments]), axis=0)
        still = [s.name for s, span in zip(signals, spans, strict=True) if not span]
        yield from (f"{name} does not move: leave it out, or fly manoeuvres that move it" for name in still)
    u = np.concatenate([s.u for s in segments])
    moving = u[:, np.ptp(u, axis=0) > 0.0]
    moving = (moving - moving.mean(axis=0)) / moving.std(axis=0)
    if moving.shape[1] > 1 and np.linalg.matrix_rank(moving) < moving.shape[1]:
        names = ", ".join(s.name for s in data.inputs)
        yield f"one of {names} follows from the others: leave it out, or move one input at a time"


def _refuse_arrays(data: object) -> None:
    if not (hasattr(data, "inputs") and hasattr(data, "outputs")):
        raise UsageError(
            f"a model is fitted to a dataset, not to {type(data).__name__}",
            hint="flysid.Dataset.from_arrays(u, y, dt_s) makes one of arrays, "
            "flysid.dataset_from(FILE, INPUT, OUTPUT) of a log or table",
        )
