"""What holds while a model is fitted: one BLAS thread, and numerical failures as FitError.

Sums of a threaded BLAS depend on the number of threads in their last bits, and a choice between orders or
rule counts can hang on those bits: fits would differ between machines. The matrices here are small, too; on
them threads cost time instead of saving it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numpy as np

from flysid.errors import FitError

P = ParamSpec("P")
R = TypeVar("R")


def on_one_thread(fit: Callable[P, R]) -> Callable[P, R]:
    """`fit`, run with BLAS limited to one thread; the caller's limits are restored.

    Where linear algebra fails for good it raises FitError: a caller never meets NumPy's own error. Trial
    models that diverge overflow on the way; the optimisers see that and step back, so it is no news.
    """

    @functools.wraps(fit)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"), np.errstate(over="ignore", invalid="ignore"):
            try:
                return fit(*args, **kwargs)
            except np.linalg.LinAlgError as error:
                raise FitError(
                    f"the numbers broke down: {error}",
                    hint="lower the orders, record longer, or check the data for jumps",
                ) from error

    return limited
