"""A transfer function in s, sampled at another rate than the one that it was fitted at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.base import Fitted
from flysid.model.freerun import Difference
from flysid.model.frequency.rational import Rational
from flysid.model.frequency.sampling import sample
from flysid.model.transfer_function import FittedTF


def resample(model: Fitted, rate_hz: float) -> Fitted:
    """The model at `rate_hz` steps a second, its inputs constant between samples.

    Raises
    ------
    UsageError : not a transfer function in s, one that drifts by itself, or no possible rate.
    """
    if not (np.isfinite(rate_hz) and rate_hz > 0.0):
        raise UsageError(f"a rate of {rate_hz!r} Hz", hint="steps a second, above 0")
    if abs(rate_hz * model.dt_s - 1.0) < 1e-9:
        return model
    if not isinstance(model, FittedTF):
        raise UsageError(
            f"a model of structure {model.structure!r} runs at {1.0 / model.dt_s:g} Hz only",
            hint="fit a transfer function in s ('flysid fit -m tf'), or leave out --rate",
        )
    dt_s = 1.0 / rate_hz
    rows = [_sample(model, i, dt_s) for i in range(len(model.outputs))]
    n_y = len(model.outputs)
    n_u = len(model.inputs)
    a = np.zeros((max(len(own) for own, _ in rows), n_y, n_y))
    b = np.zeros((max(len(t) for _, taps in rows for t in taps), n_y, n_u))
    c = np.zeros(n_y)
    for i, (own, taps) in enumerate(rows):
        a[: len(own), i, i] = own
        c[i] = own.sum() * _level(model, i)
        for j, tap in enumerate(taps):
            b[: len(tap), i, j] = tap
    return replace(model, dt_s=dt_s, system=Difference(a, b, c), starts=None)


def _sample(model: FittedTF, output: int, dt_s: float) -> tuple[FloatArray, list[FloatArray]]:
    """a and every input's b of one output; all its transfer functions have one denominator."""
    own = [model.transfer(output, j) for j in range(len(model.inputs))]
    rational = Rational(
        own[0].denominator,
        tuple(t.numerator for t in own),
        np.array([t.dead_time_s for t in own]),
    )
    return sample(rational, dt_s, "zero")


def _level(model: FittedTF, output: int) -> float:
    """Where the output rests, from its mean, while the inputs stand at theirs."""
    whole = float(model.system.a[:, output, output].sum())
    constant = float(model.system.c[output])
    if abs(whole) > 1e-9:
        return constant / whole
    if constant == 0.0:
        return 0.0
    raise UsageError(
        "an integrating transfer function with a drift of its own has no other rate",
        hint="leave out --rate, or fit it with offset=False",
    )
