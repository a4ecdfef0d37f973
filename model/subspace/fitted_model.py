"""A fitted state-space model: what it predicts and simulates, and what it says about itself.

    x(k+1) = A x(k) + B (u - u*)(k) + K e(k) + drift,    (y - y*)(k) = C x(k) + D (u - u*)(k) + level + e(k)

around the training means u*, y*. The free run is the deterministic part; predictions filter the measured
outputs with K. Where the model was fitted to the simulation error K is zero, and predictions model what the
free run leaves over as an autoregression (`noise`), as output-error models do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.model import own_constants
from flysid.model.arguments import as_columns, check_start
from flysid.model.base import write_document
from flysid.model.capabilities import FrequencyResponse
from flysid.model.control_form import ControlForm, control_of_states, with_registers
from flysid.model.documents import array_of, head_of, monic, signals_of
from flysid.model.freerun import far, saturate
from flysid.model.linear.laws import LinearLaws
from flysid.model.linear.text import gains_text
from flysid.model.noise import output_error_ahead
from flysid.model.own_constants import OwnConstants
from flysid.model.polynomials import ComplexArray, modes_of
from flysid.model.subspace.covariance_bands import response_of
from flysid.model.subspace.kalman import ahead, filtered_states, free_states, output_of, resting_state
from flysid.model.subspace.triangle import Realisation
from flysid.showing import counted


@dataclass(frozen=True, eq=False, repr=False)
class FittedStateSpace(LinearLaws):
    """A linear model in state space; the laws of `flysid.model.base` hold.

    Attributes
    ----------
    realisation : A, B, C, D, K, constants and covariances in physical units, around the origins.
    u_origin, y_origin : (n_u,), (n_y,) training means.
    gains : (n_init, n, n_y) of the Kalman predictor through the samples that start a run.
    noise : (p + 1, n_y) monic autoregression of the simulation error per output, or None: K predicts.
    free : how many entries of A, B, C, D, K and the constants are not merely a choice of coordinates.
    singular_values : of the decomposition that the order was read off, largest first.
    covariance : (p, p) of A, B, C, drift, level and, where it is free, D, row by row; (0, 0) where unknown.
        Not refined, it holds the distance to the refined estimate, too. Only what does not hang on the
        coordinates has a meaning: see `bands`.
    delays : samples by which every input is late before it enters; () for none.
    flight_offsets : what flights had beside the model in training; None where all had the same.
    """

    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    output_limits: FloatArray
    realisation: Realisation
    u_origin: FloatArray
    y_origin: FloatArray
    gains: FloatArray
    free: int
    singular_values: FloatArray
    noise: FloatArray | None = None
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    delays: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    scores: Mapping[str, float] = field(default_factory=dict)
    flight_offsets: OwnConstants | None = None

    structure = "statespace"

    @property
    def n_init(self) -> int:
        """Measured samples that start a simulation."""
        return len(self.gains)

    @property
    def n_parameters(self) -> int:
        """Entries that are not merely a choice of coordinates."""
        return self.free

    @property
    def order(self) -> int:
        """Number of states."""
        return self.realisation.order

    # -- the laws ----------------------------------------------------------------------------------------

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) free run from the first `n_init` measured outputs; from zero inputs and outputs when None.

        Raises
        ------
        UsageError : shapes do not fit the model, or fewer than `n_init` outputs are given.
        """
        system = self.realisation
        n = self.n_init
        du = as_columns(u, len(self.inputs), "u") - self.u_origin
        if y0 is None:
            du = self.late(du, -self.u_origin)
            rest = resting_state(system, -self.u_origin, -self.y_origin)
            return self.limited(output_of(system, free_states(system, du, rest), du))
        y0 = as_columns(y0, len(self.outputs), "y0")
        check_start(len(y0), min(n, len(du)))
        if len(du) <= n:
            return np.array(y0[: len(du)])
        du = self.late(du)
        start = filtered_states(system, du[:n], y0[:n] - self.y_origin, self.gains)[-1]
        run = output_of(system, free_states(system, du[n:], start), du[n:])
        return np.concatenate([y0[:n], self.limited(run)])

    # -- what people ask of a linear model ---------------------------------------------------------------

    @cached_property
    def poles(self) -> ComplexArray:
        """Poles in z, slowest first."""
        found = np.asarray(np.linalg.eigvals(self.realisation.a), dtype=np.complex128)
        return np.asarray(found[np.argsort(-np.abs(found), kind="stable")])

    @cached_property
    def dc_gain(self) -> FloatArray:
        """(n_y, n_u) steady gain; NaN where the model integrates."""
        s = self.realisation
        if np.abs(self.poles - 1.0).min(initial=np.inf) < 1e-9:
            return np.full(s.d.shape, np.nan)
        gain: FloatArray = s.c @ np.linalg.solve(np.eye(s.order) - s.a, s.b) + s.d
        return gain

    def unlimited(self) -> FittedStateSpace:
        """The model without its output limits, for the search of a start."""
        return replace(self, output_limits=far(self.output_limits))

    def states(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, n) the state before every sample, predicted from the samples before it.

        Raises
        ------
        UsageError : shapes do not fit.
        """
        du = self.late(as_columns(u, len(self.inputs), "u") - self.u_origin)
        dy = as_columns(y, len(self.outputs), "y") - self.y_origin
        found: FloatArray = filtered_states(self.realisation, du, dy, self.gains)[:-1]
        return found

    def frequency_response(self, omega: FloatArray) -> FrequencyResponse:
        """G(e^(i omega dt)) at omega in rad/s with first-order standard errors; NaN where none are known.

        Raises
        ------
        UsageError : a frequency beyond the Nyquist frequency.
        """
        return response_of(self, omega)

    def to_control(self, form: ControlForm = "auto") -> Any:
        """The model as control.StateSpace, or for "tf" as control.TransferFunction; offsets are left out.

        An input that enters late gets a shift register of states.
        """
        s = self.realisation
        matrices = with_registers((s.a, s.b, s.c, s.d), self.delays)
        return control_of_states(matrices, (self.inputs, self.outputs), self.dt_s, form)

    def __str__(self) -> str:
        kind = "simulation" if self.noise is not None else "prediction"
        lines = [
            f"State space of order {self.order}, {self.n_parameters} parameters, sample time {self.dt_s:g} s,"
            f" fitted for {kind}"
        ]
        lines.append(
            "x(k+1) = A x(k) + B u(k) + K e(k), y(k) = C x(k) + D u(k) + e(k), deviations from the means"
        )
        lines += [
            f"{name} = {np.array2string(getattr(self.realisation, name.lower()), precision=5, prefix=name)}"
            for name in ("A", "B", "C", "D", "K")
        ]
        if any(self.delays):
            late = ", ".join(f"{i.name} {k}" for i, k in zip(self.inputs, self.delays, strict=True))
            lines.append(f"inputs enter late, in samples: {late}")
        modes = modes_of(self.poles, self.dt_s)
        lines.append("poles: " + "; ".join(str(m) for m in modes))
        lines.append("steady gain: " + "; ".join(self._gains()))
        lines.append(f"intervals (+-, half the width, 95 %): {self._intervals()}")
        lines += [f"{name}: {value:.4g}" for name, value in self.scores.items()]
        return "\n".join([*lines, *(f"- {note}" for note in self.notes)])

    def _ahead(self, u: FloatArray, y: FloatArray, k: int) -> FloatArray:
        if self.noise is not None:
            return output_error_ahead(self.simulate(u, y[: self.n_init]), y, self.noise, k)
        system = self.realisation
        du = self.late(u - self.u_origin)
        states = filtered_states(system, du, y - self.y_origin, self.gains)[:-1]
        return ahead(system, states, du, k) + self.y_origin

    def _known_covariance(self) -> FloatArray:
        if not len(self.covariance):
            raise UsageError(
                "this model carries no covariance", hint="fit it in memory, with refine=True or stable=True"
            )
        return self.covariance

    def _move(self, step: FloatArray) -> FittedStateSpace:
        """The model with a step added to the numbers that its covariance is of."""
        s = self.realisation
        at = 0
        moved: dict[str, FloatArray] = {}
        for name in ("a", "b", "c", "drift", "level", "d"):
            value = getattr(s, name)
            if at < len(step):
                moved[name] = value + step[at : at + value.size].reshape(value.shape)
            at += value.size
        return replace(self, realisation=replace(s, **moved))

    def _gains(self) -> list[str]:
        errors = np.full(self.dc_gain.shape, np.nan)
        if len(self.covariance) and np.isfinite(self.dc_gain).all():
            errors = response_of(self, np.zeros(1)).magnitude_error[0]
        return gains_text(self, errors)

    def _intervals(self) -> str:
        """What is known of the uncertainty, in words."""
        if not len(self.covariance):
            return "none (fitted from disk, unstable, or too much data); refine=True estimates them"
        if self.noise is not None:
            return "of the simulation-error fit"
        return "of the scatter, and of the distance to the least simulation error (wide where biased)"

    def _conclusion(self) -> str:
        modes = "; ".join(str(m) for m in modes_of(self.poles, self.dt_s))
        names = ", ".join(s.name for s in self.outputs)
        return f"{names}: {counted(self.order, 'state')} ({modes}), steady gain {'; '.join(self._gains())}"

    def late(self, du: FloatArray, before: FloatArray | None = None) -> FloatArray:
        """The inputs as they enter; what came before the first sample is `before`, the mean when None."""
        out = np.array(du)
        for j, late in enumerate(self.delays):
            out[late:, j] = du[: max(len(du) - late, 0), j]
            out[:late, j] = 0.0 if before is None else before[j]
        return out

    def limited(self, y: FloatArray) -> FloatArray:
        """Outputs of deviations from the means, inside the output limits."""
        return saturate(y + self.y_origin, self.output_limits)

    # -- storage -----------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        return {
            **head_of(self),
            "output_limits": self.output_limits.tolist(),
            **{f.name: getattr(self.realisation, f.name).tolist() for f in fields(Realisation)},
            "u_origin": self.u_origin.tolist(),
            "y_origin": self.y_origin.tolist(),
            "gains": self.gains.tolist(),
            "delays": list(self.delays),
            "free": self.free,
            "singular_values": self.singular_values.tolist(),
            "noise": None if self.noise is None else self.noise.tolist(),
            "covariance": self.covariance.tolist(),
            "notes": list(self.notes),
            "scores": {k: float(v) for k, v in self.scores.items() if np.isfinite(v)},
            **own_constants.as_document(self.flight_offsets),
        }

    def save(self, path: str | Path) -> None:
        """Write the model as JSON; `flysid.load` reads it."""
        write_document(self.to_dict(), path)


def resting(
    matrices: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    dt_s: float,
    signals: tuple[tuple[Signal, ...], tuple[Signal, ...]],
) -> FittedStateSpace:
    """A model of given (A, B, C, D) that was not fitted: no noise, no offsets, starts at rest.

    `signals`: inputs, outputs.
    """
    a, b, c, d = (np.array(m, dtype=np.float64) for m in matrices)
    n = len(a)
    n_u = b.shape[1]
    n_y = len(c)
    still = Realisation(
        a, b, c, d, np.zeros((n, n_y)), np.zeros(n), np.zeros(n_y), np.zeros((n_y, n_y)), np.zeros((n, n))
    )
    return FittedStateSpace(
        dt_s=dt_s,
        inputs=signals[0],
        outputs=signals[1],
        output_limits=np.array([[-1e12] * n_y, [1e12] * n_y]),
        realisation=still,
        u_origin=np.zeros(n_u),
        y_origin=np.zeros(n_y),
        gains=np.zeros((0, n, n_y)),
        free=n * (n_u + n_y) + n_y * n_u,
        singular_values=np.zeros(0),
        notes=("Imported as is; nothing was estimated.",),
    )


def from_dict(document: Mapping[str, Any]) -> FittedStateSpace:
    """Rebuild a model from `to_dict()`; damage raises KeyError, TypeError or ValueError (see `base.load`)."""

    def array(key: str, *shape: int) -> FloatArray:
        return array_of(document, key, *shape)

    inputs = signals_of(document, "inputs")
    outputs = signals_of(document, "outputs")
    n_u = len(inputs)
    n_y = len(outputs)
    n = len(document["a"])
    realisation = Realisation(
        a=array("a", n, n),
        b=array("b", n, n_u),
        c=array("c", n_y, n),
        d=array("d", n_y, n_u),
        k=array("k", n, n_y),
        drift=array("drift", n),
        level=array("level", n_y),
        innovation=array("innovation", n_y, n_y),
        state=array("state", n, n),
    )
    _check_predictor(realisation)
    return FittedStateSpace(
        dt_s=float(document["dt_s"]),
        inputs=inputs,
        outputs=outputs,
        output_limits=array("output_limits", 2, n_y),
        realisation=realisation,
        u_origin=array("u_origin", n_u),
        y_origin=array("y_origin", n_y),
        gains=array("gains", -1, n, n_y),
        delays=_whole(document.get("delays", []), n_u),
        free=int(document["free"]),
        singular_values=array("singular_values", -1),
        noise=None if document["noise"] is None else monic(array("noise", -1, n_y), "noise"),
        covariance=_square(document.get("covariance", [])),
        notes=tuple(str(n) for n in document["notes"]),
        scores={str(k): float(v) for k, v in document["scores"].items()},
        flight_offsets=own_constants.from_document(document, n_y),
    )


def _check_predictor(system: Realisation) -> None:
    """Where K is not zero it stabilises the predictor: its errors die away, they never grow to infinity."""
    radius = np.abs(np.linalg.eigvals(system.a - system.k @ system.c)).max(initial=0.0)
    if system.k.any() and not radius < 1.0:
        raise ValueError(f"its predictor is not stable: radius {radius:.4g}")


def _square(rows: Any) -> FloatArray:
    values = np.asarray(rows, dtype=np.float64).reshape(len(rows), len(rows))
    if not np.isfinite(values).all():
        raise ValueError("covariance is not finite")
    return values


def _whole(values: Any, count: int) -> tuple[int, ...]:
    delays = tuple(int(v) for v in values)
    if len(delays) not in (0, count) or min(delays, default=0) < 0:
        raise ValueError("delays do not fit the inputs")
    return delays
