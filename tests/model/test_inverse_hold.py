"""The continuous transfer function behind a difference equation."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from flysid.dataset import FloatArray
from flysid.model.frequency.transfer import inverse_hold


def test_doubts_of_scipy_about_the_last_digits_are_not_the_users(monkeypatch: pytest.MonkeyPatch) -> None:
    """A drawn plant of high order met one in `logm`, which ended a run that counts warnings as errors."""
    import scipy.linalg

    true_logm = scipy.linalg.logm

    def doubtful(a: FloatArray) -> FloatArray:
        warnings.warn("logm result may be inaccurate, approximate err = 8e-13", RuntimeWarning, stacklevel=2)
        return np.asarray(true_logm(a))

    monkeypatch.setattr(scipy.linalg, "logm", doubtful)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        numerator, denominator = inverse_hold(np.array([0.0, 0.1]), np.array([1.0, -0.9]), 1, 0.1)
    assert numerator[-1] / denominator[-1] == pytest.approx(1.0)
