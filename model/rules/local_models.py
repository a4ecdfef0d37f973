"""Local linear views of a TS model: linearisation, the polytope of its rules, and stability certificates.

A TS model is a polytopic (LPV) system: its one-step map is a convex combination of the rules' affine maps,
weighted by the firing strengths. A common quadratic Lyapunov function of all rules (Tanaka and Sugeno 1992)
proves that outputs stay bounded under bounded inputs for any blend of rules, and that a run forgets its start
under any one sequence of firing strengths. Where conditions speak of outputs, two runs on the same inputs
fire differently: that these come together too is asked of runs (`flysid.model.rules.boundedness`). Its
absence proves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.rules.lyapunov import common_lyapunov
from flysid.model.rules.rule_model import Recursion, RuleModel, refuse_other_models
from flysid.model.rules.rule_poles import companion
from flysid.model.rules.steady_map import SteadyMap


@dataclass(frozen=True, eq=False)
class LocalStateSpace:
    """s(k+1) = A s(k) + B u(k) + f,  y(k) = C s(k) + D u(k) + g, physical units.

    s holds past outputs and hidden states x(k-1), ..., x(k-n), then past inputs u(k-1), ..., u(k-m); A, B and
    f are exact companion matrices of the lags, shared by every rule but for the first block of rows.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    f: FloatArray
    g: FloatArray
    dt_s: float


def polytope(model: RuleModel) -> tuple[LocalStateSpace, ...]:
    """The rules as local state spaces over one common state, ready for parallel distributed compensation.

    Raises
    ------
    UsageError : not a model of dynamic rules.
    """
    refuse_other_models(model)
    return tuple(_companion(model, rule) for rule in model.recursions())


def _companion(model: RuleModel, recursion: Recursion) -> LocalStateSpace:
    A, B, c = recursion
    na, n, _ = A.shape
    past_inputs = len(B) - 1
    n_y = model.layout.n_y
    n_u = B.shape[2]
    own = n * na
    size = own + n_u * past_inputs
    newest = np.zeros((n, size))
    newest[:, :own] = np.concatenate(list(A), axis=1) if na else 0.0
    newest[:, own:] = np.concatenate(list(B[1:]), axis=1) if past_inputs else 0.0
    step = np.zeros((size, size))
    drive = np.zeros((size, n_u))
    offset = np.zeros(size)
    if na:
        step[:n], drive[:n], offset[:n] = newest, B[0], c
        step[n:own, : own - n] = np.eye(own - n)
    if past_inputs:
        drive[own : own + n_u] = np.eye(n_u)
        step[own + n_u :, own : size - n_u] = np.eye(size - n_u - own)
    return LocalStateSpace(step, drive, newest[:n_y], B[0, :n_y].copy(), offset, c[:n_y].copy(), model.dt_s)


def linearise(model: RuleModel, u: FloatArray, y: FloatArray | None = None) -> LocalStateSpace:
    """The model's derivative at constant inputs u (n_u,), memberships included.

    Where outputs y (n_y,) are given, hidden states stand where they rest beside them; otherwise everything
    stands where the inputs hold it.

    Raises
    ------
    UsageError : u or y has another length than the model's signals; hidden states come to no rest there; the
        model is at its limit there.
    """
    refuse_other_models(model)
    layout = model.layout
    n = layout.n
    held = np.zeros(0) if y is None else np.atleast_1d(np.asarray(y, dtype=float))
    u = np.atleast_1d(np.asarray(u, dtype=float))
    if u.shape != (len(model.inputs),) or held.shape not in ((0,), (layout.n_y,)):
        raise UsageError(
            f"u has shape {u.shape}" + ("" if y is None else f" and y {held.shape}"),
            hint=f"give {len(model.inputs)} inputs and {layout.n_y} outputs",
        )
    steady = SteadyMap(layout)
    w = np.zeros(len(layout.scale))
    w[: len(held)] = (held - layout.shift[: len(held)]) / layout.scale[: len(held)]
    w[n:] = (u - layout.shift[n:]) / layout.scale[n:]
    found = steady.resting(model.free, w, range(len(held), n))
    if found is None:
        raise UsageError(
            "the model has no equilibrium at this operating point",
            hint="choose one inside the training range; an integrating process rests at one input only",
        )
    tangent = steady.tangent(model.free, found)
    _refuse_limit(tangent.value, model.free.limits, model)
    return _companion(model, _physical(steady, tangent.value, tangent.weights, found, model))


def _physical(
    steady: SteadyMap, value: FloatArray, weights: FloatArray, w: FloatArray, model: RuleModel
) -> Recursion:
    """A tangent at w as a recursion in physical units."""
    layout = model.layout
    n = layout.n
    own = steady.terms.column < n
    A = np.zeros((int(steady.terms.lag[own].max(initial=0)), n, n))
    B = np.zeros((int(steady.terms.lag[~own].max(initial=0)) + 1, n, len(model.inputs)))
    for m, (column, lag) in enumerate(zip(steady.terms.column, steady.terms.lag, strict=True)):
        gain = weights[:, m] * layout.scale[:n] / layout.scale[column]
        if column < n:
            A[lag - 1, :, column] += gain
        else:
            B[lag, :, column - n] += gain
    at = w * layout.scale + layout.shift
    c = value * layout.scale[:n] + layout.shift[:n] - A.sum(axis=0) @ at[:n] - B.sum(axis=0) @ at[n:]
    return A, B, c


def _refuse_limit(x: FloatArray, limits: FloatArray, model: RuleModel) -> None:
    """Raise UsageError where an output or state (n,) stands at its limits (2, n): nothing moves it there."""
    for i, (value, low, high) in enumerate(zip(x, *limits, strict=True)):
        rounding = 1e-9 * (high - low)
        if not low + rounding < value < high - rounding:
            at = np.clip(value, low, high) * model.layout.scale[i] + model.layout.shift[i]
            raise UsageError(
                f"the model is saturated there, at {at:.4g}, and has no linear model",
                hint="choose a place inside the training range",
            )


@dataclass(frozen=True, eq=False)
class StabilityCertificate:
    """What could be proved about stability.

    Attributes
    ----------
    proved : a common quadratic Lyapunov function was found, and checked.
    P : (n, n) its matrix, symmetric positive definite; zeros where none was found.
    decay : the worst factor by which sqrt(x'Px) shrinks per step; at least 1 where nothing is proved.
    reason : in words.
    """

    proved: bool
    P: FloatArray
    decay: float
    reason: str


def certificate(model: RuleModel) -> StabilityCertificate:
    """A P > 0 with A_r' P A_r - P < 0 for every rule's dynamics of outputs and states, where one is found.

    Raises
    ------
    UsageError : not a model of dynamic rules.
    """
    refuse_other_models(model)
    return certificate_of([companion(A) for A, _, _ in model.recursions()])


def certificate_of(rules: list[FloatArray]) -> StabilityCertificate:
    """A P > 0 with A_r' P A_r - P < 0 for the (n, n) matrices of all rules; see `lyapunov`."""
    n = len(rules[0])
    if n == 0:
        return StabilityCertificate(True, np.zeros((0, 0)), 0.0, "The model has no memory of its outputs.")
    radii = [float(np.abs(np.linalg.eigvals(A)).max()) for A in rules]
    if max(radii) >= 1.0:
        worst = int(np.argmax(radii))
        return StabilityCertificate(
            False,
            np.zeros((n, n)),
            max(radii),
            f"R{worst + 1} by itself is not stable (pole radius {radii[worst]:.4f}), so no common quadratic "
            "Lyapunov function of all rules exists; the blend may still be stable.",
        )
    found = common_lyapunov(rules)
    if found is None:
        reason = "Every rule is stable, but no common quadratic Lyapunov function was found."
        return StabilityCertificate(False, np.zeros((n, n)), 1.0, reason)
    P, decay = found
    shown = np.ceil(decay * 1e5) / 1e5
    reason = (
        f"A common quadratic Lyapunov function proves it: the norm of the state falls to {shown:.5f} of "
        "itself or less per step, for any blend of rules; bounded inputs give bounded outputs."
    )
    return StabilityCertificate(True, P, decay, reason)
