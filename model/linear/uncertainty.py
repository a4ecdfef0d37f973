"""What the parameters' covariance means: bands on the frequency response and on the free run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.covariance import root_of, spread_of
from flysid.model.freerun import Difference
from flysid.model.linear.model import FittedLinear

ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Response of a linear model.

    Attributes
    ----------
    omega : (M,) rad/s.
    response : (M, n_y, n_u) complex.
    magnitude_error, phase_error : (M, n_y, n_u) standard errors of |G| and of its phase in rad (first order).
    """

    omega: FloatArray
    response: ComplexArray
    magnitude_error: FloatArray
    phase_error: FloatArray


def below_nyquist(omega: FloatArray, dt_s: float) -> FloatArray:
    """(M,) the frequencies, rad/s.

    Raises
    ------
    UsageError : one is negative, or beyond the Nyquist frequency.
    """
    omega = np.atleast_1d(np.asarray(omega, dtype=np.float64))
    nyquist = np.pi / dt_s
    if (omega > nyquist * (1 + 1e-9)).any() or (omega < 0).any():
        raise UsageError(f"frequencies must lie between 0 and the Nyquist frequency, {nyquist:.4g} rad/s")
    return omega


def frequency_response(model: FittedLinear, omega: FloatArray) -> FrequencyResponse:
    """G(e^(i omega dt)) with first-order standard errors (Ljung, 1999, 9.6).

    Raises
    ------
    UsageError : a frequency beyond the Nyquist frequency.
    """
    omega = below_nyquist(omega, model.dt_s)
    s = model.system
    delay = np.exp(-1j * omega * model.dt_s)
    a = np.einsum("ml,lij->mij", delay[:, None] ** np.arange(len(s.a)), s.a)
    b = np.einsum("ml,lij->mij", delay[:, None] ** np.arange(len(s.b)), s.b)
    inverse = np.linalg.inv(a)
    g = inverse @ b
    slopes = _slopes(model, delay, inverse, g)
    covariance = model.covariance
    real, imaginary = slopes.real, slopes.imag
    size = np.maximum(np.abs(g), np.finfo(float).tiny)
    along = (g.real[..., None] * real + g.imag[..., None] * imaginary) / size[..., None]
    across = (g.real[..., None] * imaginary - g.imag[..., None] * real) / size[..., None] ** 2
    return FrequencyResponse(omega, g, spread_of(along, covariance), spread_of(across, covariance))


def _slopes(model: FittedLinear, delay: ComplexArray, inverse: ComplexArray, g: ComplexArray) -> ComplexArray:
    """(M, n_y, n_u, p) derivatives of G with respect to every estimated parameter."""
    n_y = g.shape[1]
    a_size, b_size = model.system.a[1:].size, model.system.b.size
    out = np.zeros((*g.shape, len(model.free)), dtype=np.complex128)
    for p, index in enumerate(model.free):
        if index < a_size:
            lag, row, column = np.unravel_index(index, (len(model.system.a) - 1, n_y, n_y))
            factor = delay ** (int(lag) + 1)
            out[..., p] = -factor[:, None, None] * inverse[:, :, [row]] * g[:, [column], :]
        elif index < a_size + b_size:
            lag, row, column = np.unravel_index(index - a_size, model.system.b.shape)
            out[:, :, column, p] = (delay ** int(lag))[:, None] * inverse[:, :, row]
    return out


def simulation_band(
    model: FittedLinear, u: FloatArray, y0: FloatArray | None = None, *, draws: int = 200, seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    """(lower, upper), (N, n_y) each: pointwise 95 % band of the free run over the parameters' uncertainty.

    Parameters are drawn from their normal distribution; draws that are unstable are drawn again, up to ten
    times `draws` in all.

    Raises
    ------
    UsageError : the model carries no covariance.
    """
    if not np.isfinite(model.covariance).all() or not len(model.free):
        raise UsageError("this model carries no covariance", hint="fit it, rather than take it over")
    models = drawn(model, _moved, model.covariance, draws, seed)
    low, high = np.percentile([m.simulate(u, y0) for m in models], [2.5, 97.5], axis=0)
    return low, high


class _Stable(Protocol):
    """A model that knows whether it is stable."""

    @property
    def is_stable(self) -> bool: ...


_M = TypeVar("_M", bound=_Stable)


def drawn(
    model: _M, moved: Callable[[_M, FloatArray], _M], covariance: FloatArray, draws: int, seed: int
) -> list[_M]:
    """Models whose parameters are drawn from their normal distribution; for a stable model, stable ones.

    Unstable draws are drawn again, up to ten times `draws` in all.

    Parameters
    ----------
    moved : the model with a step added to its parameters.

    Raises
    ------
    UsageError : nearly every draw is unstable.
    """
    rng = np.random.default_rng(seed)
    root = root_of(covariance)
    found: list[_M] = []
    for _ in range(10 * draws):
        other = moved(model, root @ rng.standard_normal(len(covariance)))
        if other.is_stable or not model.is_stable:
            found.append(other)
        if len(found) == draws:
            break
    if not found:
        raise UsageError("nearly every draw of the parameters is unstable: no band can be given")
    return found


def _moved(model: FittedLinear, step: FloatArray) -> FittedLinear:
    s = model.system
    flat = model.flat
    flat[list(model.free)] += step
    a_size = s.a[1:].size
    a = np.concatenate([s.a[:1], flat[:a_size].reshape(s.a[1:].shape)])
    b = flat[a_size : a_size + s.b.size].reshape(s.b.shape)
    return replace(model, system=Difference(a, b, flat[a_size + s.b.size :]))
