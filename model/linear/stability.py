"""Unstable estimates: named, and on request made stable.

Least squares one step ahead may end with a pole outside the unit circle although the plant is stable. Made
stable, such poles are mirrored into the circle (where outputs feed each other: all poles are drawn in
alike), and what is left of the model, B and c, is fitted again: to the simulation error, in which they are
linear, with the state at every segment's start estimated along. Their intervals then hold for these poles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FitError
from flysid.model.freerun import Difference
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.noise import coloured_covariance, noise_model
from flysid.model.polynomials import NEARLY_ONE, stabilise


def keep_stable(model: FittedLinear, data: Dataset, *, stable: bool) -> FittedLinear:
    """The model itself where it is stable; else with a note, or made stable where `stable` asks for it.

    Raises FitError: no segment is long enough to fit the rest of a model made stable.
    """
    if model.is_stable:
        return model
    radius = float(np.abs(model.poles).max())
    if not stable:
        return replace(model, notes=(*model.notes, unstable_words(radius, model.dt_s)))
    return made_stable(model, data)


def unstable_words(radius: float, dt_s: float) -> str:
    """What an unstable estimate means and what to do."""
    doubles = f", errors double every {np.log(2) / np.log(radius) * dt_s:.3g} s" if radius > 1.0 else ""
    return (
        f"Unstable: the largest pole radius is {radius:.5f}{doubles}. Simulate short spans only. If the "
        "plant is stable, fit with stable=True, with refine=True or a lower order, or take out a trend; if "
        "it flies under a controller, look for feedback."
    )


def made_stable(model: FittedLinear, data: Dataset) -> FittedLinear:
    """The model with its poles inside the circle and B and c fitted again.

    Raises FitError: no segment is long enough.
    """
    radius = float(np.abs(model.poles).max())
    system = _inside(model.system)
    refit = _Refit(model, Difference(system.a, model.system.b, model.system.c))
    pieces = [p for p in (refit.piece(s.u, s.y) for s in data.segments) if p is not None]
    if not pieces:
        raise FitError(
            "no segment is long enough to make the model stable",
            hint="bring longer segments, or a lower order",
        )
    phi, goal = (np.concatenate(x) for x in zip(*pieces, strict=True))
    size = np.maximum(np.linalg.norm(phi, axis=0), 1e-300)
    values = np.linalg.lstsq(phi / size, goal, rcond=1e-10)[0] / size
    fitted = refit.with_values(np.asarray(values))
    d, variance = noise_model([y - p @ values for p, y in pieces])
    covariance = coloured_covariance([p for p, _ in pieces], d, variance)
    now = float(np.abs(replace(model, system=fitted).poles).max())
    words = (
        f"Made stable: the largest pole radius was {radius:.5f} and is {now:.5f}; B and the constant were "
        "fitted again to the simulation error, and their intervals hold for these poles."
    )
    return replace(
        model,
        system=fitted,
        free=tuple(refit.places),
        covariance=covariance,
        starts=None,
        n_init=max(fitted.depth, 1),
        notes=(*model.notes, words),
    )


def _inside(system: Difference) -> Difference:
    """Poles mirrored into the circle, output by output; drawn in alike where outputs feed each other."""
    a = system.a.copy()
    if system.is_diagonal:
        for i in range(a.shape[1]):
            a[:, i, i] = stabilise(a[:, i, i], NEARLY_ONE)
        return replace(system, a=a)
    n = len(a) - 1
    n_y = a.shape[1]
    companion = np.eye(n_y * n, k=-n_y)
    companion[:n_y] = -np.hstack(list(a[1:]))
    shrink = NEARLY_ONE / float(np.abs(np.linalg.eigvals(companion)).max())
    return replace(system, a=a * (shrink ** np.arange(n + 1))[:, None, None])


@dataclass(frozen=True, eq=False)
class _Refit:
    """B and c of a model whose A is given; they are linear in its simulation."""

    model: FittedLinear
    system: Difference

    @property
    def places(self) -> list[int]:
        """Their places in the flat order: those of B and c that the model had estimated."""
        a_size = self.system.a[1:].size
        return [i for i in self.model.free if i >= a_size]

    def piece(self, u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """(M, p) responses to a one in every coefficient and (M,) outputs, the start's effect taken out of
        both; None for a segment that is too short."""
        depth = self.system.depth
        n_y = self.system.a.shape[1]
        if len(y) <= depth * (n_y + 2) + len(self.places) // n_y:
            return None
        du = u - self.model.u_origin
        dy = y - self.model.y_origin
        rest = np.zeros((depth, n_y))
        columns = [self._response(place, du, rest)[depth:] for place in self.places]
        starts = []
        for lag, i in np.ndindex(depth, n_y):
            state = rest.copy()
            state[lag, i] = 1.0
            starts.append(self.system.respond(np.zeros((len(y) - depth, n_y)), state))
        phi = np.stack([c.ravel() for c in columns], axis=1)
        space, _ = np.linalg.qr(np.stack([s.ravel() for s in starts], axis=1))
        goal = dy[depth:].ravel()
        return phi - space @ (space.T @ phi), goal - space @ (space.T @ goal)

    def _response(self, place: int, du: FloatArray, rest: FloatArray) -> FloatArray:
        """(N, n_y) from rest, to a one in one coefficient of B or c."""
        at = place - self.system.a[1:].size
        drive = np.zeros((len(du), rest.shape[1]))
        if at < self.system.b.size:
            lag, row, column = (int(k) for k in np.unravel_index(at, self.system.b.shape))
            drive[lag:, row] = du[: len(du) - lag, column]
        else:
            drive[:, at - self.system.b.size] = 1.0
        return self.system.respond(drive, rest)

    def with_values(self, values: FloatArray) -> Difference:
        """The system with these coefficients."""
        flat = np.concatenate([self.system.b.ravel(), self.system.c])
        flat[np.array(self.places, dtype=int) - self.system.a[1:].size] = values
        size = self.system.b.size
        return replace(self.system, b=flat[:size].reshape(self.system.b.shape), c=flat[size:])
