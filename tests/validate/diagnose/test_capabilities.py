"""`validate` asks a model what it can do, not what it is: a structure it does not know is checked, too."""

from __future__ import annotations

from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.rules.fitted import FittedTS
from flysid.model.ts import TS, over_lags
from flysid.validate.diagnose.checks import check


class Theirs:
    """Another package's rules: not a class of flysid's, with the same abilities."""

    def __init__(self, inner: FittedTS) -> None:
        self.inner = inner

    def uncertainty(self, train: Dataset) -> Any:
        return self.inner.uncertainty(train)

    @property
    def operating_points(self) -> Any:
        return self.inner.operating_points

    def certificate(self) -> Any:
        return self.inner.certificate()

    def simplifications(self, train: Dataset) -> Any:
        return self.inner.simplifications(train)

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        return self.inner.predict(u, y, k)

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        return self.inner.simulate(u, y0)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)


def _data(seed: int) -> Dataset:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, 60), 10)
    y = np.zeros(600)
    for k in range(1, 600):
        y[k] = 0.8 * y[k - 1] + 0.2 * np.tanh(2.0 * u[k - 1])
    return Dataset.from_arrays(u, y + 0.01 * rng.normal(size=600), 0.05)


def test_a_model_of_another_package_is_checked_like_one_of_ours() -> None:
    train = _data(0)
    test = _data(1)
    ours = over_lags(TS(rules=2, na=1, nb=1, nk=1), train)
    theirs: Any = Theirs(ours)
    own = check(ours, test, train)
    other = check(theirs, test, train)
    assert own.certificate == other.certificate != ""
    assert own.proved == other.proved
    assert [str(s) for s in own.simpler] == [str(s) for s in other.simpler] != []
    assert own.intervals is not None
    assert other.intervals is not None
    assert np.array_equal(own.intervals.gain, other.intervals.gain, equal_nan=True)
    assert own.intervals.coefficients == other.intervals.coefficients
