"""A fitted Takagi-Sugeno state-space model: what it simulates, predicts, says and stores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import UsageError
from flysid.model.arguments import as_columns, as_record
from flysid.model.base import OperatingPoint, Rule
from flysid.model.documents import head_of, points_as_json, points_from, signals_of
from flysid.model.noise import output_error_ahead
from flysid.model.regressors import lagged_name
from flysid.model.rules.fitted_lags import time_constant, values_at
from flysid.model.rules.free_run_error import started_run
from flysid.model.rules.integrity import check_states
from flysid.model.rules.kernel import Parameters, firing
from flysid.model.rules.phrases import condition_in_words, equation, in_words
from flysid.model.rules.realisation import Prior, initial_states
from flysid.model.rules.regressor_layout import Antecedent
from flysid.model.rules.rule_model import Ruled
from flysid.model.rules.state_layout import StateLayout
from flysid.model.start import full_window, start_window

if TYPE_CHECKING:
    from flysid.model.rules.explanation import Explanation
    from flysid.model.rules.local_models import Certificate, StateSpace
    from flysid.model.rules.state_uncertainty import StateUncertainty

_REST = 20  # rows of zeros that put a model to rest


@dataclass(frozen=True, eq=False, repr=False)
class FittedTSStateSpace(Ruled):
    """A TS state-space model; see the laws in flysid.model.base.

    Attributes
    ----------
    layout : signals, states, antecedents, scaling.
    parameters : consequents and memberships in normalised units; its limits include ends of travel.
    prior : what training says about states, from which the first outputs start a run.
    n_init : measured samples that start a simulation.
    output_limits : (2, n_y) range of the training outputs, widened by itself on each side.
    support : (R,) share of training samples for which each rule is the strongest.
    noise : (p + 1, n_y) monic autoregression of the free run's error per output, for predictions.
    operating_points : what the model does where its vehicle rests; () where it never does, or not asked.
    """

    dt_s: float
    layout: StateLayout
    parameters: Parameters
    prior: Prior
    n_init: int
    output_limits: FloatArray
    support: FloatArray
    notes: tuple[str, ...]
    noise: FloatArray
    operating_points: tuple[OperatingPoint, ...] = ()

    structure = "ts_ss"

    # -- the laws ----------------------------------------------------------------------------------------

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) free run from the most likely state given the first n_init measured outputs.

        When None: from rest, that is with inputs and outputs at zero before the first sample.

        Raises
        ------
        UsageError : shapes do not fit, or fewer than n_init outputs are given.
        """
        u = as_columns(u, len(self.inputs), "u")
        if y0 is None:
            W = self.started(u, None)
            rows = len(W) - len(u)
            return self.outputs_of(self.run(W, rows))[rows:]
        given = as_columns(y0, self.layout.n_y, "y0")[: self.n_init]
        if len(given) < min(self.n_init, len(u)):
            raise UsageError(f"{len(given)} measured samples; the model starts from {self.n_init}")
        given = given[: len(u)]
        if len(u) <= self.n_init:
            return np.array(given)
        result = self.outputs_of(self.run(self.layout.stack(u, given), self.n_init))
        result[: self.n_init] = given
        return result

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        """(N, n_y) predictions from outputs at least k steps old; the first n_init + k - 1 rows are NaN.

        The free run, and what the noise model foresees of its error; once a second (or five times the
        start) has been measured, the run's state is estimated from all of it.

        Raises
        ------
        UsageError : shapes do not fit, or k < 1.
        """
        u, y = as_record(self, u, y, k)
        first = self.n_init + k - 1
        out = np.full(y.shape, np.nan)
        for rows in (self.n_init, full_window(self.n_init, self.dt_s)):
            begin = rows + k - 1
            if begin < len(y):
                free = self.outputs_of(self.run(self.layout.stack(u, y[:rows]), rows))
                out[begin:] = output_error_ahead(free, y, self.noise, k)[begin:]
        out[:first] = np.nan
        return out

    def rules(self) -> tuple[Rule, ...]:
        """Every rule in words."""
        return tuple(self._rule(r) for r in range(len(self.parameters.theta)))

    def firing(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, R) normalised firing strengths: hidden states from the free run, outputs as measured."""
        W = self.seen(u, y)
        return np.asarray(firing(W, self.layout.depth, self.layout.lags, self.parameters))

    def rule_outputs(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, R, n_y) what every rule concludes along measured data, hidden states from the free run; NaN in
        the first n_init rows."""
        W = self.seen(u, y)
        theta = self.parameters.theta
        n_y = self.layout.n_y
        d = max(self.n_init, self.layout.depth)
        rows = len(W)
        result = np.full((rows, len(theta), n_y), np.nan)
        if rows > d:
            x = [
                np.ones(rows - d) if c < 0 else W[d - lag : rows - lag, c]
                for c, lag in self.layout.regressors
            ]
            part = np.einsum("rim,mn->nri", theta[:, :n_y], np.stack(x))
            result[d:] = part * self.layout.scale[:n_y] + self.layout.shift[:n_y]
        return result

    def states(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, n) states of the free run along measured data, physical units (hidden ones in spreads)."""
        u = as_columns(u, len(self.inputs), "u")
        y = as_columns(y, self.layout.n_y, "y")
        rows = min(len(y), max(self.n_init, start_window(self.n_init, len(y), self.dt_s)))
        W = self.run(self.layout.stack(u, y[:rows]), rows)
        n = self.layout.n
        return np.asarray(W[:, :n] * self.layout.scale[:n] + self.layout.shift[:n])

    # -- what the rules say ------------------------------------------------------------------------------

    def local_poles(self) -> tuple[FloatArray, ...]:
        """Poles of every rule by itself, slowest first (complex where they oscillate)."""
        n = self.layout.n
        found = (np.linalg.eigvals(theta[:, :n]) for theta in self.consequents)
        return tuple(p[np.argsort(-np.abs(p), kind="stable")] for p in found)

    def local_polynomials(self) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
        """Per rule (A, B, c): y(k) = sum_j A[j-1] y(k-j) + sum_j B[j] u(k-j) + c, physical units.

        The rule's state space as a difference equation, its hidden states eliminated: with the adjugate of
        I - A/z by the Faddeev-LeVerrier recursion; A is (n, n_y, n_y), a common denominator.
        """
        return tuple(self._polynomials(theta) for theta in self.consequents)

    def _polynomials(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        n = self.layout.n
        n_y = self.layout.n_y
        n_u = len(self.inputs)
        step = theta[:, :n]
        M = np.eye(n)
        A = np.zeros((n, n_y, n_y))
        c = np.zeros(n_y)
        B = np.zeros((n + self.layout.depth, n_y, n_u))
        for j in range(n):
            for m, (column, lag) in enumerate(self.layout.regressors[:-1]):
                if column >= n:
                    B[lag + j, :, column - n] += (M @ theta[:, m])[:n_y]
            c += (M @ theta[:, -1])[:n_y]
            coefficient = -float(np.trace(M @ step)) / (j + 1)
            A[j] = -coefficient * np.eye(n_y)
            M = M @ step + coefficient * np.eye(n)
        return A, B, c

    def _rule(self, r: int) -> Rule:
        layout = self.layout
        n = self.layout.n
        n_y = self.layout.n_y
        theta = self.consequents[r]
        names = layout.regressor_names[:-1]
        text = ", ".join(
            equation(lagged_name(s.name, 0), theta[i, :-1], names, theta[i, -1])
            for i, s in enumerate(layout.signals[:n])
        )
        radius = float(np.abs(self.local_poles()[r]).max())
        left = np.eye(n) - theta[:, :n]
        gain = np.zeros((n, len(layout.inputs)))
        for m, (column, _) in enumerate(layout.regressors[:-1]):
            if column >= n:
                gain[:, column - n] += theta[:, m]
        singular = np.linalg.cond(left) > 1e12
        steady = np.full((n_y, gain.shape[1]), np.nan) if singular else np.linalg.solve(left, gain)[:n_y]
        units = [layout.signals[a.column].unit for a in layout.antecedents]
        condition = condition_in_words(self.partition, r, self.antecedents, units)
        return Rule(
            label=f"R{r + 1}",
            condition=condition,
            conclusion=text,
            dc_gain=steady,
            time_constant_s=time_constant(radius, self.dt_s),
            pole_radius=radius,
            support=float(self.support[r]),
            here=self.loudest(r),
            push=self.push(r),
        )

    def __str__(self) -> str:
        """The rules and how they were chosen, in words."""
        count = len(self.parameters.theta)
        layout = self.layout
        title = f"Takagi-Sugeno state-space model, {count} rule{'s' if count > 1 else ''}, {layout.n} states"
        title += f" ({layout.hidden} hidden), {self.n_parameters} parameters"
        return in_words(title, self.rules(), self.notes, (self.outputs, self.inputs), self.operating_points)

    def explain(self, u: FloatArray, y: FloatArray, row: int) -> Explanation:
        """Which rules spoke at a sample of measured data, how loudly and why; see `explain.explain`."""
        from flysid.model.rules.state_explanation import explain

        return explain(self, u, y, row)

    def linearise(self, at: Mapping[str, float]) -> StateSpace:
        """The local linear model while every signal stands at a value; see `local.linearise`.

        Hidden states stand where they rest beside the others.

        Parameters
        ----------
        at : signal's name -> value; signals left out stand at their mean in training.

        Raises
        ------
        UsageError : a name that is no signal of the model, or hidden states that come to no rest,
            a value that is no number, a place at which an output is at its limit.
        """
        from flysid.model.rules.state_local_models import linearise

        n_y = self.layout.n_y
        n = self.layout.n
        shift = self.layout.shift
        known = np.concatenate([shift[:n_y], shift[n:]])
        values = values_at([s.name for s in (*self.outputs, *self.inputs)], known, at)
        return linearise(self, values[n_y:], values[:n_y])

    def outside_share(self, u: FloatArray, y: FloatArray) -> float:
        """Share of samples, 0 to 1, in which an antecedent lies outside the range seen in training."""
        from flysid.model.rules.state_explanation import outside_share

        return outside_share(self, u, y)

    def polytope(self) -> tuple[StateSpace, ...]:
        """The rules as local state spaces over one common state; see `local.polytope`."""
        from flysid.model.rules.state_local_models import polytope

        return polytope(self)

    def certificate(self) -> Certificate:
        """What can be proved about the stability of any blend of the rules; see `local.certificate`."""
        from flysid.model.rules.state_local_models import certificate

        return certificate(self)

    def uncertainty(self, train: Dataset) -> StateUncertainty:
        """How sure the model is of its numbers, from the data that it was fitted to; see `uncertainty`."""
        from flysid.model.rules.state_uncertainty import uncertainty

        return uncertainty(self, train)

    def to_control(self) -> Any:
        """The model as a `control.NonlinearIOSystem`, which follows `simulate` sample by sample."""
        from flysid.model.rules.state_local_models import to_nonlinear_system

        return to_nonlinear_system(self)

    # -- storage -----------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        layout = self.layout
        return {
            **head_of(self),
            "hidden": layout.hidden,
            "input_lags": [list(lags) for lags in layout.input_lags],
            "antecedents": [[a.column, a.lag] for a in layout.antecedents],
            "shift": layout.shift.tolist(),
            "scale": layout.scale.tolist(),
            "parameters": {name: value.tolist() for name, value in self.parameters._asdict().items()},
            "prior": {
                "mean": self.prior.mean.tolist(),
                "inverse": self.prior.inverse.tolist(),
                "weight": self.prior.weight,
            },
            "n_init": self.n_init,
            "output_limits": self.output_limits.tolist(),
            "support": self.support.tolist(),
            "noise": self.noise.tolist(),
            "operating_points": points_as_json(self.operating_points),
            "notes": list(self.notes),
        }

    def started(self, u: FloatArray, y0: FloatArray | None) -> FloatArray:
        """W that a run computes: rows of zeros before the inputs where it starts from rest."""
        u = as_columns(u, len(self.inputs), "u")
        if y0 is not None:
            return self.layout.stack(u, as_columns(y0, self.layout.n_y, "y0")[: self.n_init])
        rows = _REST + self.n_init
        return self.layout.stack(
            np.vstack([np.zeros((rows, u.shape[1])), u]), np.zeros((rows, self.layout.n_y))
        )

    # -- parts -------------------------------------------------------------------------------------------

    def run(self, W: FloatArray, rows: int) -> FloatArray:
        """W simulated from the most likely state given its first `rows` rows of outputs."""
        depth = self.layout.depth
        if len(W) < depth:
            return W
        known = max(min(rows, len(W)) - depth + 1, 1)
        x = initial_states(self.layout, [W], self.parameters, self.prior, known)[0]
        return started_run(self.layout, W, x, self.parameters)

    def outputs_of(self, W: FloatArray) -> FloatArray:
        """(N, n_y) physical outputs of a run, inside the output limits."""
        return np.asarray(np.clip(self.layout.outputs_of(W), *self.output_limits))

    def seen(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """W with measured outputs and the free run's hidden states."""
        u, y = as_record(self, u, y)
        W = self.layout.stack(u, y)
        n = self.layout.n
        n_y = self.layout.n_y
        states = self.states(u, y)
        W[:, n_y:n] = (states[:, n_y:] - self.layout.shift[n_y:n]) / self.layout.scale[n_y:n]
        return W


def from_dict(document: Mapping[str, Any]) -> FittedTSStateSpace:
    """Rebuild a model from `to_dict()`; damage raises KeyError, TypeError or ValueError (see `base.load`)."""
    numbers = {name: np.array(value, dtype=np.float64) for name, value in document["parameters"].items()}
    rules = len(numbers["theta"])
    n_z = len(document["antecedents"])
    for name, shape in (("centre", (rules, n_z)), ("width", (rules, n_z)), ("z_range", (2, n_z))):
        numbers[name] = numbers[name].reshape(shape)
    layout = StateLayout(
        outputs=signals_of(document, "outputs"),
        inputs=signals_of(document, "inputs"),
        hidden=int(document["hidden"]),
        input_lags=tuple(tuple(int(lag) for lag in lags) for lags in document["input_lags"]),
        antecedents=tuple(Antecedent(int(c), int(lag)) for c, lag in document["antecedents"]),
        shift=np.array(document["shift"], dtype=np.float64),
        scale=np.array(document["scale"], dtype=np.float64),
    )
    prior = document["prior"]
    n = layout.n
    model = FittedTSStateSpace(
        dt_s=float(document["dt_s"]),
        layout=layout,
        parameters=Parameters(**numbers),
        prior=Prior(
            np.array(prior["mean"], dtype=np.float64).reshape(n),
            np.array(prior["inverse"], dtype=np.float64).reshape(n, n),
            float(prior["weight"]),
        ),
        n_init=int(document["n_init"]),
        output_limits=np.array(document["output_limits"], dtype=np.float64),
        support=np.array(document["support"], dtype=np.float64),
        notes=tuple(str(n) for n in document["notes"]),
        noise=np.array(document["noise"], dtype=np.float64),
        operating_points=points_from(document.get("operating_points", ())),
    )
    check_states(layout, model.parameters, model.noise)
    return model
