"""What holds while a model is fitted."""

from __future__ import annotations

import scipy.linalg  # noqa: F401 - it brings a BLAS of its own
from threadpoolctl import threadpool_info, threadpool_limits

from flysid.model.threads import on_one_thread


def threads() -> set[int]:
    """Of every BLAS in this process."""
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_every_blas_has_one_thread_while_a_model_is_fitted_and_as_many_as_before_afterwards() -> None:
    within = on_one_thread(threads)
    for before in (2, 3):
        with threadpool_limits(limits=before, user_api="blas"):
            assert within() == {1}
            assert threads() == {before}
