"""A fitted model as a blend of affine systems in physical units: linear parameter-varying form.

    z(k) = P x(k) + Q u(k), held inside its range;   weights w_r(z), which sum to 1
    x(k+1) = sum_r w_r (A_r x + B_r u + f_r),        y(k) = sum_r w_r (C_r x + D_r u + g_r), inside its limits

x holds past outputs, hidden states and past inputs; `states` names each. A linear model is one system, whose
f and g are its offsets. What gain scheduling, an LPV toolbox, or a simulation by hand needs.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.export.program import Memberships, Program
from flysid.export.programs import program_of
from flysid.model.base import Fitted

FORMAT = "flysid-lpv"
VERSION = 1
MATRICES = ("A", "B", "f", "C", "D", "g")


@dataclass(frozen=True, eq=False)
class Lpv:
    """Affine systems and when each speaks.

    `states`: name, lag in samples and unit of every entry of x.
    `A`, `B`, `f`, `C`, `D`, `g`: (R, n, n), (R, n, n_u), (R, n), (R, n_y, n), (R, n_y, n_u), (R, n_y).
    `P`, `Q`: (n_z, n), (n_z, n_u) scheduling; no rows for one system.
    `memberships`: over z, in physical units; None for one system.
    `x0`: (n,) at rest: where all inputs and outputs were zero.
    `output_limits`: (2, n_y).
    """

    title: str
    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    states: tuple[tuple[str, int, str], ...]
    A: FloatArray
    B: FloatArray
    f: FloatArray
    C: FloatArray
    D: FloatArray
    g: FloatArray
    P: FloatArray
    Q: FloatArray
    memberships: Memberships | None
    x0: FloatArray
    output_limits: FloatArray

    def weights(self, z: FloatArray) -> FloatArray:
        """(R,) of the systems at scheduling values z (n_z,)."""
        return np.ones(1) if self.memberships is None else self.memberships.weights(z)

    def simulate(self, u: FloatArray, x: FloatArray | None = None) -> FloatArray:
        """(N, n_y) for inputs (N, n_u), from rest or from x."""
        x = self.x0 if x is None else np.asarray(x, dtype=np.float64)
        out = np.empty((len(u), len(self.outputs)))
        for k, now in enumerate(np.asarray(u, dtype=np.float64).reshape(len(u), -1)):
            w = self.weights(self.P @ x + self.Q @ now)
            out[k] = w @ (self.C @ x + self.D @ now + self.g)
            x = w @ (self.A @ x + self.B @ now + self.f)
        return np.clip(out, *self.output_limits)

    def to_control(self) -> Any:
        """One system as control.StateSpace with a further input "one", always 1, for the offsets.

        Simulate it from `x0`. Raises UsageError: there are several systems.
        """
        import control

        if len(self.A) > 1:
            raise UsageError(
                f"{len(self.A)} systems are not one linear system", hint="model.to_control() keeps the rules"
            )
        return control.ss(
            self.A[0],
            np.column_stack([self.B[0], self.f[0]]),
            self.C[0],
            np.column_stack([self.D[0], self.g[0]]),
            self.dt_s,
            inputs=[*(s.name for s in self.inputs), "one"],
            outputs=[s.name for s in self.outputs],
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        m = self.memberships
        return {
            "format": FORMAT,
            "version": VERSION,
            "title": self.title,
            "dt_s": self.dt_s,
            "inputs": [[s.name, s.unit] for s in self.inputs],
            "outputs": [[s.name, s.unit] for s in self.outputs],
            "states": [list(s) for s in self.states],
            **{name: getattr(self, name).tolist() for name in (*MATRICES, "P", "Q", "x0", "output_limits")},
            "memberships": None
            if m is None
            else {
                "shape": m.shape,
                "conjunction": m.conjunction,
                **{k: getattr(m, k).tolist() for k in Memberships.NUMBERS},
            },
        }

    def to_json(self) -> str:
        """As text."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"

    def to_mat(self) -> bytes:
        """As a MATLAB file: matrices stacked along the third dimension, as MATLAB's LPV objects take them."""
        from scipy.io import savemat

        told: dict[str, Any] = {
            name: np.moveaxis(getattr(self, name), 0, -1) if name in MATRICES else getattr(self, name)
            for name in (*MATRICES, "P", "Q", "x0", "output_limits")
        }
        told |= {"dt_s": self.dt_s, "title": self.title}
        told |= {
            "inputs": np.array([s.name for s in self.inputs], dtype=object),
            "outputs": np.array([s.name for s in self.outputs], dtype=object),
            "states": np.array([f"{name}(k-{lag})" for name, lag, _ in self.states], dtype=object),
        }
        if self.memberships is not None:
            m = self.memberships
            told |= {k: getattr(m, k) for k in (*Memberships.NUMBERS, "shape", "conjunction")}
        file = io.BytesIO()
        savemat(file, told, oned_as="column")
        return file.getvalue()


def to_lpv(model: Fitted, rate_hz: float | None = None) -> Lpv:
    """A fitted model in linear parameter-varying form, whatever its structure.

    `rate_hz`: steps a second, of a transfer function in s.
    Raises UsageError: the model has no single step (an ensemble).

    >>> arx = flysid.ARX(na=1, nb=1, nk=1, refine=False).fit(train)  # train: see `flysid.Dataset`
    >>> to_lpv(arx).A.shape
    (1, 2, 2)
    """
    return lpv_of(program_of(model, rate_hz))


def lpv_of(program: Program) -> Lpv:
    """The same of a program, without the limits of hidden quantities, far outside of what a model does."""
    if any(w.operation != "change" for w in program.worked):
        raise UsageError(
            "the model has products, magnitudes or signs of signals, and no affine system has those",
            hint="export C, an FMU or MATLAB code",
        )
    n_u = len(program.inputs)
    n_y = len(program.outputs)
    size = len(program.memory)
    rows = _cells(program, size, n_u)
    at = [
        program.cell(int(c), int(lag)) for c, lag in zip(program.lags.column, program.lags.lag, strict=True)
    ]
    count, n, _ = program.theta.shape
    own = program.scale[:n, None]
    after = own * (program.theta @ rows[at])  # (R, n, size + n_u + 1), physical
    after[:, :, -1] += program.shift[:n]
    step = np.zeros((count, size, size + n_u + 1))
    places = {cell: i for i, cell in enumerate(program.memory)}
    for (column, lag), i in places.items():
        if lag > 1:
            step[:, i, places[column, lag - 1]] = 1.0
        elif column < n:
            step[:, i] = after[:, column]
        else:
            step[:, i, size + column - n] = 1.0
    P, memberships = _scheduling(program, rows)
    return Lpv(
        program.title,
        program.dt_s,
        program.inputs,
        program.outputs,
        tuple((program.signals[c].name, lag, program.signals[c].unit) for c, lag in program.memory),
        *_split(step, size),
        *_split(after[:, :n_y], size),
        P[:, :size],
        P[:, size:],
        memberships,
        program.remembered(program.start),
        program.output_limits,
    )


def _split(whole: FloatArray, size: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    return whole[..., :size].copy(), whole[..., size:-1].copy(), whole[..., -1].copy()


def _cells(program: Program, size: int, n_u: int) -> FloatArray:
    """(cells, size + n_u + 1) of x, u and 1 in physical units to normalised cells."""
    rows = np.zeros((program.cells, size + n_u + 1))
    rows[0, -1] = 1.0
    here = [(c, lag, i) for i, (c, lag) in enumerate(program.memory)]
    here += [(program.n + j, 0, size + j) for j in range(n_u)]
    for column, lag, place in here:
        cell = program.cell(column, lag)
        rows[cell, place] = 1.0 / program.scale[column]
        rows[cell, -1] = -program.shift[column] / program.scale[column]
    for _, to, a, b, *_ in program.working:
        rows[to] = rows[a] - rows[b]
    return rows


def _scheduling(program: Program, rows: FloatArray) -> tuple[FloatArray, Memberships | None]:
    """(n_z, n + n_u) of x and u to physical antecedents, and memberships over them."""
    m = program.memberships
    if m is None:
        return np.zeros((0, rows.shape[1] - 1)), None
    lags = program.lags
    scale = program.scale[lags.z_column]
    whole = np.array(
        [
            rows[program.cell(int(c), int(lag))]
            - (rows[program.cell(int(c), int(minus))] if minus >= 0 else 0.0)
            for c, lag, minus in zip(lags.z_column, lags.z_lag, lags.z_minus, strict=True)
        ]
    )
    shift = -whole[:, -1] * scale
    return scale[:, None] * whole[:, :-1], Memberships(
        m.centre * scale + shift,
        m.left * scale,
        m.right * scale,
        m.low * scale + shift,
        m.high * scale + shift,
        m.shape,
        m.conjunction,
    )


def _memberships(document: Mapping[str, Any]) -> Memberships:
    return Memberships(
        np.array(document["centre"], dtype=np.float64),
        np.array(document["left"], dtype=np.float64),
        np.array(document["right"], dtype=np.float64),
        np.array(document["low"], dtype=np.float64),
        np.array(document["high"], dtype=np.float64),
        document["shape"],
        document["conjunction"],
    )


def from_dict(document: Mapping[str, Any]) -> Lpv:
    """What `Lpv.to_dict` gave."""
    m = document["memberships"]
    n = len(document["x0"])
    n_u = len(document["inputs"])
    n_y = len(document["outputs"])
    shapes = {"A": (n, n), "B": (n, n_u), "f": (n,), "C": (n_y, n), "D": (n_y, n_u), "g": (n_y,)}
    arrays = {
        k: np.array(document[k], dtype=np.float64).reshape(len(document[k]), *shape)
        for k, shape in shapes.items()
    }
    arrays |= {k: np.array(document[k], dtype=np.float64) for k in ("x0", "output_limits")}
    return Lpv(
        title=str(document["title"]),
        dt_s=float(document["dt_s"]),
        inputs=tuple(Signal(*s) for s in document["inputs"]),
        outputs=tuple(Signal(*s) for s in document["outputs"]),
        states=tuple((str(a), int(b), str(c)) for a, b, c in document["states"]),
        P=np.array(document["P"], dtype=np.float64).reshape(len(document["P"]), n),
        Q=np.array(document["Q"], dtype=np.float64).reshape(len(document["Q"]), n_u),
        memberships=None if m is None else _memberships(m),
        **arrays,
    )
