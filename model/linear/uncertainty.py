"""What the parameters' covariance means: bands on the frequency response and on the free run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.model.capabilities import Coefficient, FrequencyResponse
from flysid.model.covariance import root_of, spread_of
from flysid.model.freerun import Difference
from flysid.model.polynomials import Z95, ComplexArray
from flysid.model.regressors import lagged_name


class DifferenceModel(Protocol):
    """A difference equation of which some coefficients were estimated; see
    `flysid.model.linear.difference_equation`."""

    @property
    def dt_s(self) -> float: ...
    @property
    def inputs(self) -> tuple[Signal, ...]: ...
    @property
    def outputs(self) -> tuple[Signal, ...]: ...
    @property
    def system(self) -> Difference: ...
    @property
    def free(self) -> tuple[int, ...]: ...
    @property
    def covariance(self) -> FloatArray: ...
    @property
    def flat(self) -> FloatArray: ...
    @property
    def standard_errors(self) -> FloatArray: ...


def below_nyquist(omega: FloatArray, dt_s: float) -> FloatArray:
    """(M,) the frequencies, rad/s. Raises UsageError: one is negative, or beyond the Nyquist frequency."""
    omega = np.atleast_1d(np.asarray(omega, dtype=np.float64))
    nyquist = np.pi / dt_s
    if (omega > nyquist * (1 + 1e-9)).any() or (omega < 0).any():
        raise UsageError(f"frequencies must lie between 0 and the Nyquist frequency, {nyquist:.4g} rad/s")
    return omega


def response_of(model: DifferenceModel, omega: FloatArray) -> FrequencyResponse:
    """G(e^(i omega dt)) with first-order standard errors (Ljung, 1999, 9.6); NaN errors where none are known.

    Raises UsageError: a frequency beyond the Nyquist frequency.
    """
    omega = below_nyquist(omega, model.dt_s)
    s = model.system
    delay = np.exp(-1j * omega * model.dt_s)
    a = np.einsum("ml,lij->mij", delay[:, None] ** np.arange(len(s.a)), s.a)
    b = np.einsum("ml,lij->mij", delay[:, None] ** np.arange(len(s.b)), s.b)
    inverse = np.linalg.inv(a)
    g = inverse @ b
    slopes = _slopes(model, delay, inverse, g)
    covariance = model.covariance if len(model.free) else np.full((1, 1), np.nan)
    real = slopes.real
    imaginary = slopes.imag
    size = np.maximum(np.abs(g), np.finfo(float).tiny)
    along = (g.real[..., None] * real + g.imag[..., None] * imaginary) / size[..., None]
    across = (g.real[..., None] * imaginary - g.imag[..., None] * real) / size[..., None] / size[..., None]
    return FrequencyResponse(omega, g, spread_of(along, covariance), spread_of(across, covariance))


def _slopes(
    model: DifferenceModel, delay: ComplexArray, inverse: ComplexArray, g: ComplexArray
) -> ComplexArray:
    """(M, n_y, n_u, p) derivatives of G with respect to every estimated parameter."""
    n_y = g.shape[1]
    a_size = model.system.a[1:].size
    b_size = model.system.b.size
    out = np.zeros((*g.shape, max(len(model.free), 1)), dtype=np.complex128)
    for p, index in enumerate(model.free):
        if index < a_size:
            lag, row, column = np.unravel_index(index, (len(model.system.a) - 1, n_y, n_y))
            factor = delay ** (int(lag) + 1)
            out[..., p] = -factor[:, None, None] * inverse[:, :, [row]] * g[:, [column], :]
        elif index < a_size + b_size:
            lag, row, column = np.unravel_index(index - a_size, model.system.b.shape)
            out[:, :, column, p] = (delay ** int(lag))[:, None] * inverse[:, :, row]
    return out


class _Runs(Protocol):
    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray: ...


STEP = 0.01
"""Of a standard deviation: small enough that a run moves in proportion to it."""


def draw_steps(covariance: FloatArray, count: int, seed: int) -> list[FloatArray]:
    """Steps (P,) of the parameters, drawn from their normal distribution; the same for the same seed."""
    rng = np.random.default_rng(seed)
    root = root_of(covariance)
    return [root @ rng.standard_normal(len(covariance)) for _ in range(count)]


def free_run_band(
    model: _Runs,
    moved: Callable[[FloatArray], _Runs],
    covariance: FloatArray,
    draws: int,
    seed: int,
    *,
    u: FloatArray,
    y0: FloatArray | None,
) -> tuple[FloatArray, FloatArray]:
    """(lower, upper), (N, n_y) each: pointwise 95 % of the free run, to first order in the parameters.

    Whole draws of a slow pole drift away or are unstable, however well its response is known in the band of
    the data; a small step in each drawn direction, scaled up, tells what the numbers' uncertainty does here.

    `moved`: gives the model with a step added to its parameters.
    """
    nominal = model.simulate(u, y0)
    steps = draw_steps(covariance, draws, seed)
    runs = [nominal + (moved(STEP * step).simulate(u, y0) - nominal) / STEP for step in steps]
    low, high = np.percentile(runs, [2.5, 97.5], axis=0)
    return low, high


def coefficients_of(model: DifferenceModel) -> list[Coefficient]:
    """Estimated entries of A and B, signed as in the equation y(k) = ...; offsets are around the means.

    None where the model carries no covariance.
    """
    if not np.isfinite(model.covariance).all():
        return []
    n_y = len(model.outputs)
    n_u = len(model.inputs)
    a_size = model.system.a[1:].size
    b_size = model.system.b.size
    found = []
    for index in model.free:
        value = float(model.flat[index])
        error = float(model.standard_errors[index])
        if index < a_size:
            lag, i, j = _place(index, (len(model.system.a) - 1, n_y, n_y))
            name = lagged_name(model.outputs[j].name, lag + 1)
            value = -value
        elif index < a_size + b_size:
            lag, i, j = _place(index - a_size, (len(model.system.b), n_y, n_u))
            name = lagged_name(model.inputs[j].name, lag)
        else:
            i = index - a_size - b_size
            name = "1, around the means"
        found.append(Coefficient("", model.outputs[i].name, name, value, Z95 * error))
    return found


def _place(index: int, shape: tuple[int, int, int]) -> tuple[int, int, int]:
    lag, i, j = (int(v) for v in np.unravel_index(index, shape))
    return lag, i, j
