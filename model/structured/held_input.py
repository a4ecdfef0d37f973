"""A continuous system behind a hold, sampled exactly, its inputs late by fractions of a sample.

Åström & Wittenmark (1997), Computer-Controlled Systems, 2.3 and 3.2. What of an input is late by a part of a
sample sits in one more state, its value a sample ago; with a first-order hold (the input runs straight
between samples) the part that the next sample has in the state is taken into the output.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.frequency.rational import Hold
from flysid.model.polynomials import ComplexArray


@dataclass(frozen=True, eq=False)
class Held:
    """x(k+1) = A x + B u, y = C x + D u; input j enters `late[j]` samples after it was given.

    The last states are the earlier values of the inputs that `registers` names.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    late: tuple[int, ...]

    def response(self, omega: FloatArray, dt_s: float) -> ComplexArray:
        """(M, n_y, n_u)."""
        z = np.exp(1j * omega * dt_s)
        inside = z[:, None, None] * np.eye(len(self.a)) - self.a
        g = self.c @ np.linalg.solve(inside, self.b.astype(np.complex128)) + self.d
        delay = z[:, None] ** -np.array(self.late, dtype=np.float64)
        return np.asarray(g * delay[:, None, :])


def whole_samples(delay_s: FloatArray, dt_s: float) -> tuple[int, ...]:
    """Full samples in delays, rounding aside."""
    return tuple(int(np.floor(max(t, 0.0) / dt_s + 1e-9)) for t in delay_s)


def held(
    matrices: Mapping[str, FloatArray],
    dt_s: float,
    hold: Hold,
    registers: tuple[int, ...],
    late: tuple[int, ...],
) -> Held:
    """Sample F, G, H, D with their delays.

    `registers`: inputs whose delay may be no whole number of samples.
    `late`: whole samples of delay; the rest, of a register from 0 up to and with 1, is what `matrices` say
        beyond them.
    """
    from scipy.linalg import expm

    f = matrices["F"]
    g = matrices["G"]
    n = len(f)
    n_u = g.shape[1]
    generator = np.zeros((n + 2, n + 2))
    generator[:n, :n] = f
    generator[n, n + 1] = 1.0
    whole = expm(f * dt_s)
    before = np.zeros((n, n_u))
    now = np.zeros((n, n_u))
    after = np.zeros((n, n_u))
    through = matrices["D"].copy()
    through_before = np.zeros_like(through)
    for j in range(n_u):
        generator[:n, n] = g[:, j]
        part = float(matrices["delay"][0, j]) / dt_s - late[j] if j in registers else 0.0
        first = expm(generator * (part * dt_s))
        second = expm(generator * ((1.0 - part) * dt_s))
        rest = second[:n, :n]
        if hold == "zero":
            before[:, j] = rest @ first[:n, n]
            now[:, j] = second[:n, n]
            share = float(part > 0.0)
        else:
            ramp = first[:n, n + 1] / dt_s
            before[:, j] = rest @ (first[:n, n] * part - ramp)
            after[:, j] = second[:n, n + 1] / dt_s
            now[:, j] = rest @ (first[:n, n] * (1.0 - part) + ramp) + second[:n, n] - after[:, j]
            share = part
        through_before[:, j] = share * through[:, j]
        through[:, j] *= 1.0 - share
    m = len(registers)
    pick = list(registers)
    a = np.block([[whole, before[:, pick]], [np.zeros((m, n + m))]])
    b = np.vstack([whole @ after + now, np.eye(n_u)[pick]])
    c = np.hstack([matrices["H"], through_before[:, pick]])
    return Held(a, b, c, matrices["H"] @ after + through, late)
