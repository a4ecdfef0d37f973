"""What the covariance of a refined state-space model means: bands on its frequency response and its free run.

A covariance of matrices hangs on the coordinates of the state; these figures do not.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.covariance import spread_of
from flysid.model.linear.uncertainty import FrequencyResponse, below_nyquist, drawn

if TYPE_CHECKING:
    from flysid.model.subspace.model import FittedStateSpace

ComplexArray = npt.NDArray[np.complex128]


def frequency_response(model: FittedStateSpace, omega: FloatArray) -> FrequencyResponse:
    """G(e^(i omega dt)) with first-order standard errors; NaN errors where the model carries no covariance.

    Raises
    ------
    UsageError : a frequency beyond the Nyquist frequency.
    """
    omega = below_nyquist(omega, model.dt_s)
    s = model.realisation
    z = np.exp(1j * omega * model.dt_s)
    resolvent = np.linalg.inv(z[:, None, None] * np.eye(s.order) - s.a)
    late = np.stack([z**-k for k in model.delays or (0,) * len(model.inputs)], axis=1)[:, None]
    g = np.asarray((s.c @ resolvent @ s.b + s.d) * late, dtype=np.complex128)
    if not len(model.covariance):
        unknown = np.full(g.shape, np.nan)
        return FrequencyResponse(omega, g, unknown, unknown)
    slopes = _slopes(model, resolvent) * late[..., None]
    size = np.maximum(np.abs(g), np.finfo(float).tiny)[..., None]
    along = (g.real[..., None] * slopes.real + g.imag[..., None] * slopes.imag) / size
    across = (g.real[..., None] * slopes.imag - g.imag[..., None] * slopes.real) / size**2
    return FrequencyResponse(
        omega, g, spread_of(along, model.covariance), spread_of(across, model.covariance)
    )


def _slopes(model: FittedStateSpace, resolvent: ComplexArray) -> ComplexArray:
    """(M, n_y, n_u, p) derivatives of G with respect to A, B, C, drift, level (and D), row by row."""
    s = model.realisation
    m, n, (n_y, n_u) = len(resolvent), s.order, s.d.shape
    left, right = s.c @ resolvent, resolvent @ s.b
    a = np.einsum("moi,mju->mouij", left, right).reshape(m, n_y, n_u, n * n)
    b = np.einsum("moi,uv->mouiv", left, np.eye(n_u)).reshape(m, n_y, n_u, n * n_u)
    c = np.einsum("op,mju->moupj", np.eye(n_y), right).reshape(m, n_y, n_u, n_y * n)
    none = np.zeros((m, n_y, n_u, n + n_y))
    parts = [a, b, c, none]
    if len(model.covariance) > sum(x.shape[-1] for x in parts):
        d = np.einsum("op,uv->oupv", np.eye(n_y), np.eye(n_u)).reshape(n_y, n_u, n_y * n_u)
        parts.append(np.broadcast_to(d, (m, *d.shape)))
    return np.concatenate(parts, axis=-1)


def simulation_band(
    model: FittedStateSpace, u: FloatArray, y0: FloatArray | None = None, *, draws: int = 200, seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    """(lower, upper), (N, n_y) each: pointwise 95 % band of the free run over the parameters' uncertainty.

    Draws that are unstable are drawn again, up to ten times `draws` in all.

    Raises
    ------
    UsageError : the model carries no covariance, or nearly every draw is unstable.
    """
    if not len(model.covariance):
        raise UsageError(
            "this model carries no covariance", hint="fit it in memory, with refine=True or stable=True"
        )
    models = drawn(model, _moved, model.covariance, draws, seed)
    low, high = np.percentile([m.simulate(u, y0) for m in models], [2.5, 97.5], axis=0)
    return low, high


def _moved(model: FittedStateSpace, step: FloatArray) -> FittedStateSpace:
    s, at = model.realisation, 0
    moved: dict[str, FloatArray] = {}
    for name in ("a", "b", "c", "drift", "level", "d"):
        value = getattr(s, name)
        if at < len(step):
            moved[name] = value + step[at : at + value.size].reshape(value.shape)
        at += value.size
    return replace(model, realisation=replace(s, **moved))
