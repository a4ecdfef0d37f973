"""A fitted linear difference equation with its noise model: what every linear structure becomes.

    A(q) (y - y*) = B(q) (u - u*) + c + noise

around the training means u*, y* (kept apart so that a large offset costs no digits). The free run is the
deterministic part. Prediction depends on how the noise enters: through 1/A (equation error; the predictor
regresses on measured lags), or added to the free run as an autoregression of its own (output error).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.filters import apply_filter
from flysid.model import own_constants
from flysid.model.arguments import as_columns, check_start
from flysid.model.base import write_document
from flysid.model.capabilities import Coefficient, FrequencyResponse
from flysid.model.control_form import ControlForm, control_of_difference
from flysid.model.documents import array_of, head_of, monic, signals_of, with_null
from flysid.model.freerun import Difference, far, saturate
from flysid.model.linear.laws import LinearLaws
from flysid.model.linear.text import conclusion, describe
from flysid.model.linear.uncertainty import coefficients_of, response_of
from flysid.model.noise import k_step_ahead
from flysid.model.own_constants import OwnConstants
from flysid.model.polynomials import ComplexArray


@dataclass(frozen=True, eq=False, repr=False)
class FittedLinear(LinearLaws):
    """A linear model; the laws of `flysid.model.base` hold.

    Attributes
    ----------
    structure : "arx", "oe", ...
    system : A, B and c in physical units, around the origins.
    u_origin, y_origin : (n_u,), (n_y,) training means.
    noise : (p + 1, n_y) monic autoregression of the simulation error per output, or None: noise enters
        through 1/A.
    starts : (n_y, L, n_init) estimate of the starting state from the first outputs (see
        `freerun.start_gain`), or None: the lags are taken as measured.
    free : indices of the estimated parameters in `flat` order.
    covariance : (n_parameters, n_parameters) of the estimated parameters; NaN where unknown.
    output_limits : the training range, widened by its width on both sides.
    scores : figures of the fit for people, e.g. {"validation free run RMSE": 0.02}.
    ma : (q + 1, n_y) monic moving average C of the noise per output, or None: C = 1.
    noise_parameters : how many coefficients of the noise model were estimated as the model's own.
    flight_offsets : what flights had beside the model in training; None where all had the same.
    """

    structure: str
    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    n_init: int
    output_limits: FloatArray
    system: Difference
    u_origin: FloatArray
    y_origin: FloatArray
    noise: FloatArray | None
    starts: FloatArray | None
    free: tuple[int, ...]
    covariance: FloatArray
    notes: tuple[str, ...] = ()
    scores: Mapping[str, float] = field(default_factory=dict)
    ma: FloatArray | None = None
    noise_parameters: int = 0
    flight_offsets: OwnConstants | None = None

    @property
    def n_parameters(self) -> int:
        """Estimated coefficients, of the noise model's those that are its own."""
        return len(self.free) + self.noise_parameters

    @property
    def flat(self) -> FloatArray:
        """A_1.., B_0.., c in one row; `free` points into it."""
        s = self.system
        return np.concatenate([s.a[1:].ravel(), s.b.ravel(), s.c])

    @cached_property
    def standard_errors(self) -> FloatArray:
        """Standard error of every entry of `flat`; 0 for those that were not estimated."""
        errors = np.zeros(len(self.flat))
        errors[list(self.free)] = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return errors

    # -- the laws ----------------------------------------------------------------------------------------

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) free run from the first `n_init` measured outputs; from zero inputs and outputs when None.

        Raises
        ------
        UsageError : shapes do not fit the model, or fewer than `n_init` outputs are given.
        """
        u = as_columns(u, len(self.inputs), "u")
        if y0 is None:
            return saturate(self._from_rest(u), self.output_limits)
        n = self.n_init
        y0 = as_columns(y0, len(self.outputs), "y0")
        check_start(len(y0), min(n, len(u)))
        du = u - self.u_origin
        dy = y0[:n] - self.y_origin
        if len(u) <= n:
            return np.array(y0[: len(u)])
        first, state = self.begin(du, dy)
        tail = saturate(self.system.run(du[first:], state)[n - first :] + self.y_origin, self.output_limits)
        return np.concatenate([y0[:n], tail])

    def meanings(self) -> list[str]:
        """What every nonlinear term does, as of the polynomial that `PolyNARX` looked for: there is none."""
        return []

    def unlimited(self) -> FittedLinear:
        """The model without its output limits, for the search of a start."""
        return replace(self, output_limits=far(self.output_limits))

    def among(self, inputs: Sequence[Signal], strange: Sequence[int]) -> FittedLinear:
        """The same model as one of more inputs, of which those in the places `strange` do nothing."""
        if not strange:
            return self
        own = [j for j in range(len(inputs)) if j not in strange]
        lags, n_y, _ = self.system.b.shape
        b = np.zeros((lags, n_y, len(inputs)))
        b[:, :, own] = self.system.b
        places = np.arange(b.size).reshape(b.shape)[:, :, own].ravel()
        first = self.system.a[1:].size
        after = self.system.a[1:].size + self.system.b.size
        moved = [
            i if i < first else first + int(places[i - first]) if i < after else i - after + first + b.size
            for i in self.free
        ]
        origin = np.zeros(len(inputs))
        origin[own] = self.u_origin
        system = replace(self.system, b=b)
        return replace(self, inputs=tuple(inputs), system=system, u_origin=origin, free=tuple(moved))

    # -- what people ask of a linear model ---------------------------------------------------------------

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles in z, slowest first (without those at zero)."""
        n_y = self.system.a.shape[1]
        n = len(self.system.a) - 1
        if n == 0:
            return np.zeros(0, dtype=np.complex128)
        companion = np.eye(n_y * n, k=-n_y)
        companion[:n_y] = -np.hstack(list(self.system.a[1:]))
        found = np.asarray(np.linalg.eigvals(companion), dtype=np.complex128)
        found = found[np.abs(found) > 1e-12]
        return np.asarray(found[np.argsort(-np.abs(found), kind="stable")])

    @cached_property
    def dc_gain(self) -> FloatArray:
        """(n_y, n_u) steady gain; NaN where the model integrates."""
        a_sum = self.system.a.sum(axis=0)
        b_sum = self.system.b.sum(axis=0)
        if self.poles.size and np.abs(self.poles - 1.0).min() < 1e-9:
            return np.full(b_sum.shape, np.nan)
        gain: FloatArray = np.linalg.solve(a_sum, b_sum)
        return gain

    def frequency_response(self, omega: FloatArray) -> FrequencyResponse:
        """G(e^(i omega dt)) at omega in rad/s with first-order standard errors (Ljung, 1999, 9.6).

        Raises
        ------
        UsageError : a frequency beyond the Nyquist frequency.
        """
        return response_of(self, omega)

    def coefficients(self) -> list[Coefficient]:
        """Estimated entries of A and B, signed as in y(k) = ...; none where there is no covariance."""
        return coefficients_of(self)

    def to_control(self, form: ControlForm = "auto", *, offsets: bool = False) -> Any:
        """The model as a discrete python-control system with named signals; offsets are left out.

        Parameters
        ----------
        offsets : with a further input "one", always 1, through which the offsets enter; from rest it then
            follows `simulate` (python-control knows no output limits).
        form : "tf", control.TransferFunction, the polynomials digit by digit (not for coupled outputs);
            "ss", control.StateSpace; "auto" is "tf" for one input and output, else "ss" (python-control
            simulates transfer matrices with an extra library only).

        Raises
        ------
        UsageError : a transfer matrix was asked for of coupled outputs.
        """
        if not offsets:
            return control_of_difference(self.system, (self.inputs, self.outputs), self.dt_s, form)
        s = self.system
        constant = s.c + s.a.sum(axis=0) @ self.y_origin - s.b.sum(axis=0) @ self.u_origin
        b = np.concatenate([s.b, np.zeros((*s.b.shape[:2], 1))], axis=2)
        b[0, :, -1] = constant
        signals = ((*self.inputs, Signal("one")), self.outputs)
        return control_of_difference(replace(s, b=b), signals, self.dt_s, form)

    def __str__(self) -> str:
        return describe(self)

    # -- storage -----------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        return {
            **head_of(self),
            "n_init": self.n_init,
            "output_limits": self.output_limits.tolist(),
            "a": self.system.a.tolist(),
            "b": self.system.b.tolist(),
            "c": self.system.c.tolist(),
            "u_origin": self.u_origin.tolist(),
            "y_origin": self.y_origin.tolist(),
            "noise": None if self.noise is None else self.noise.tolist(),
            "starts": None if self.starts is None else self.starts.tolist(),
            "ma": None if self.ma is None else self.ma.tolist(),
            "noise_parameters": self.noise_parameters,
            "free": list(self.free),
            "covariance": with_null(self.covariance),
            "notes": list(self.notes),
            "scores": {k: float(v) for k, v in self.scores.items() if np.isfinite(v)},
            **own_constants.as_document(self.flight_offsets),
        }

    def save(self, path: str | Path) -> None:
        """Write the model as JSON; `flysid.load` reads it."""
        write_document(self.to_dict(), path)

    # -- parts -------------------------------------------------------------------------------------------

    def _ahead(self, u: FloatArray, y: FloatArray, k: int) -> FloatArray:
        if self.noise is None:
            drive = self.system.drive(u - self.u_origin)
            e = self._innovations(self.system.a, y - self.y_origin, drive)
            return k_step_ahead(self.system.a, y - self.y_origin, drive, k, self.ma, e) + self.y_origin
        free = self.simulate(u, y[: self.n_init])
        coloured = np.stack([np.diag(row) for row in self.noise])
        e = self._innovations(coloured, y - free, np.zeros_like(y))
        return free + k_step_ahead(coloured, y - free, np.zeros_like(y), k, self.ma, e)

    def _innovations(self, a: FloatArray, y: FloatArray, drive: FloatArray) -> FloatArray | None:
        """(N, n_y) e of A y = drive + C e, zero in the first n_init rows; None where C = 1."""
        if self.ma is None:
            return None
        right = y - drive
        for lag in range(1, len(a)):
            right[lag:] += y[:-lag] @ a[lag].T
        right[: self.n_init] = 0.0
        return np.stack(
            [apply_filter(np.ones(1), self.ma[:, i], right[:, i]) for i in range(y.shape[1])], axis=1
        )

    def _conclusion(self) -> str:
        return conclusion(self)

    def _known_covariance(self) -> FloatArray:
        if not np.isfinite(self.covariance).all() or not len(self.free):
            raise UsageError("this model carries no covariance", hint="fit it, rather than take it over")
        return self.covariance

    def _move(self, step: FloatArray) -> FittedLinear:
        """The model with a step added to its estimated parameters."""
        s = self.system
        flat = self.flat
        flat[list(self.free)] += step
        a_size = s.a[1:].size
        a = np.concatenate([s.a[:1], flat[:a_size].reshape(s.a[1:].shape)])
        b = flat[a_size : a_size + s.b.size].reshape(s.b.shape)
        return replace(self, system=Difference(a, b, flat[a_size + s.b.size :]))

    def _from_rest(self, u: FloatArray) -> FloatArray:
        depth = self.system.depth
        past_u = np.tile(-self.u_origin, (depth, 1))
        past_y = np.tile(-self.y_origin, (depth, 1))
        return self.system.run(u - self.u_origin, self.system.state(past_u, past_y)) + self.y_origin

    def begin(self, du: FloatArray, dy: FloatArray) -> tuple[int, FloatArray]:
        """Where a free run along deviations du, dy begins, and the state (L, n_y) it has there."""
        n = self.n_init
        system = self.system
        if self.starts is None:
            return n, system.state(du[:n], dy[:n])
        zero = np.zeros((system.depth, len(self.outputs)))
        miss = dy[:n] - system.run(du[:n], zero)
        return 0, np.einsum("oln,no->lo", self.starts, miss)

    def start_responses(self, rows: int) -> FloatArray:
        """(rows, n_y, n_init, n_y) what one unit of each first output adds to a free run without limits."""
        n = self.n_init
        n_y = len(self.outputs)
        first = n if self.starts is None else 0
        still = np.zeros((rows - first, n_y))
        found = np.zeros((rows, n_y, n, n_y))
        if self.starts is None and len(self.system.a) == 1:  # no output is fed back: none is remembered
            np.einsum("ioio->io", found[:n])[:] = 1.0
            return found
        for i, o in np.ndindex(n, n_y):
            found[i, o, i, o] = 1.0
            given = found[:n, :, i, o]
            if self.starts is None:
                state = self.system.state(np.zeros((n, len(self.inputs))), given)
            else:
                state = np.einsum("oln,no->lo", self.starts, given)
            found[n:, :, i, o] = self.system.respond(still, state)[n - first :]
        return found


def from_dict(document: Mapping[str, Any]) -> FittedLinear:
    """Rebuild a model from `to_dict()`; damage raises KeyError, TypeError or ValueError (see `base.load`)."""

    outputs = signals_of(document, "outputs")
    inputs = signals_of(document, "inputs")
    n_y = len(outputs)
    n_u = len(inputs)

    def array(key: str, *shape: int) -> FloatArray:
        return array_of(document, key, *shape)

    def optional(key: str, *shape: int) -> FloatArray | None:
        return None if document.get(key) is None else array(key, *shape)

    noise = optional("noise", -1, n_y)
    ma = optional("ma", -1, n_y)
    system = Difference(monic(array("a", -1, n_y, n_y), "a"), array("b", -1, n_y, n_u), array("c", n_y))
    free = tuple(int(i) for i in document["free"])
    if len(set(free) & set(range(system.a[1:].size + system.b.size + n_y))) < len(free):
        raise ValueError("free holds places where no parameter is, or one twice")
    covariance = np.asarray(document["covariance"], dtype=np.float64).reshape(len(free), len(free))
    return FittedLinear(
        structure=str(document["structure"]),
        dt_s=float(document["dt_s"]),
        inputs=inputs,
        outputs=outputs,
        n_init=int(document["n_init"]),
        output_limits=array("output_limits", 2, n_y),
        system=system,
        u_origin=array("u_origin", n_u),
        y_origin=array("y_origin", n_y),
        noise=None if noise is None else monic(noise, "noise"),
        starts=optional("starts", n_y, -1, -1),
        free=free,
        covariance=covariance,
        notes=tuple(str(n) for n in document["notes"]),
        scores={str(k): float(v) for k, v in document["scores"].items()},
        ma=None if ma is None else monic(ma, "ma"),
        noise_parameters=int(document.get("noise_parameters", 0)),
        flight_offsets=own_constants.from_document(document, n_y),
    )
