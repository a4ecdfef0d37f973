"""What the covariance of a refined state-space model means: bands on its frequency response and its free run.

A covariance of matrices hangs on the coordinates of the state; these figures do not.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.model.capabilities import FrequencyResponse
from flysid.model.covariance import spread_of
from flysid.model.linear.uncertainty import below_nyquist
from flysid.model.polynomials import ComplexArray
from flysid.model.subspace.triangle import Realisation


class StateModel(Protocol):
    """A state-space model with the covariance of its matrices; see `flysid.model.subspace.fitted_model`."""

    @property
    def dt_s(self) -> float: ...
    @property
    def inputs(self) -> tuple[Signal, ...]: ...
    @property
    def realisation(self) -> Realisation: ...
    @property
    def covariance(self) -> FloatArray: ...
    @property
    def delays(self) -> tuple[int, ...]: ...


def response_of(model: StateModel, omega: FloatArray) -> FrequencyResponse:
    """G(e^(i omega dt)) with first-order standard errors; NaN errors where the model carries no covariance.

    Raises UsageError: a frequency beyond the Nyquist frequency.
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


def _slopes(model: StateModel, resolvent: ComplexArray) -> ComplexArray:
    """(M, n_y, n_u, p) derivatives of G with respect to A, B, C, drift, level (and D), row by row."""
    s = model.realisation
    m = len(resolvent)
    n = s.order
    (n_y, n_u) = s.d.shape
    left = s.c @ resolvent
    right = resolvent @ s.b
    a = np.einsum("moi,mju->mouij", left, right).reshape(m, n_y, n_u, n * n)
    b = np.einsum("moi,uv->mouiv", left, np.eye(n_u)).reshape(m, n_y, n_u, n * n_u)
    c = np.einsum("op,mju->moupj", np.eye(n_y), right).reshape(m, n_y, n_u, n_y * n)
    none = np.zeros((m, n_y, n_u, n + n_y))
    parts = [a, b, c, none]
    if len(model.covariance) > sum(x.shape[-1] for x in parts):
        d = np.einsum("op,uv->oupv", np.eye(n_y), np.eye(n_u)).reshape(n_y, n_u, n_y * n_u)
        parts.append(np.broadcast_to(d, (m, *d.shape)))
    return np.concatenate(parts, axis=-1)
