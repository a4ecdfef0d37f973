"""A fitted dynamic Takagi-Sugeno model: rules over lagged inputs and outputs.

    R_r: If z_1(k) is A_r1 and ... then y(k) = sum a_rj y(k-j) + sum b_rj u(k-nk-j) + c_r

with the firing strengths and the weighted mean of the paper's eq. (1)-(3) (Takagi and Sugeno, 1985).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import UsageError
from flysid.model.arguments import as_columns, as_record
from flysid.model.base import OperatingPoint, Rule
from flysid.model.documents import array_or_none, head_of, points_as_json, points_from, signals_of
from flysid.model.noise import output_error_ahead
from flysid.model.regressors import lagged_name
from flysid.model.rules.free_run_error import widened
from flysid.model.rules.integrity import check
from flysid.model.rules.judging import estimated_initial
from flysid.model.rules.kernel import Parameters, firing, free_run, predict
from flysid.model.rules.phrases import condition_in_words, equation, in_words
from flysid.model.rules.regressor_layout import REACH, Antecedent, Layout, Orders
from flysid.model.rules.rule_model import Ruled
from flysid.model.rules.rule_poles import pole_radius, unheld
from flysid.model.start import estimate_start, full_window

if TYPE_CHECKING:
    from flysid.model.rules.explanation import Explanation
    from flysid.model.rules.local_models import Certificate, StateSpace
    from flysid.model.rules.rule_uncertainty import RuleUncertainty
    from flysid.model.rules.simplify import Simplification


@dataclass(frozen=True, eq=False, repr=False)
class FittedTS(Ruled):
    """A dynamic TS model; see the laws in flysid.model.base.

    Attributes
    ----------
    layout : signals, orders, antecedents, scaling.
    parameters : consequents and memberships in normalised units.
    initial_gain : correction of measured first samples, see `initial_state_gain`.
    support : (R,) share of training samples for which each rule is the strongest.
    noise : (p + 1, n_y) monic autoregression of the free run's error per output, which predictions lean
        on; None: predictions regress on measured lags.
    operating_points : what the model does where its vehicle rests; () where it never does, or not asked.
    """

    dt_s: float
    layout: Layout
    parameters: Parameters
    initial_gain: FloatArray
    support: FloatArray
    notes: tuple[str, ...]
    noise: FloatArray | None = None
    operating_points: tuple[OperatingPoint, ...] = ()

    structure = "ts"

    @property
    def n_init(self) -> int:
        """Measured samples that start a simulation."""
        return self.layout.depth

    @property
    def output_limits(self) -> FloatArray:
        """(2, n_y) range of the training outputs, widened by itself on each side."""
        n = self.layout.n_y
        return np.asarray(self.parameters.limits * self.layout.scale[:n] + self.layout.shift[:n])

    @property
    def trained_range(self) -> FloatArray:
        """(2, n_z) smallest and largest antecedents of the training data, physical units.

        The memberships go on beyond, a quarter of this range on either side, before they stay as they are.
        """
        return widened(super().trained_range, -REACH / (1.0 + 2.0 * REACH))

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        """(N, n_y) predictions from outputs at least k steps old; the first n_init + k - 1 rows are NaN.

        A model refined on the simulation error adds to its free run what its noise model foresees, once it
        has seen enough to start that run; lags as they were measured carry their noise into every step.

        Raises
        ------
        UsageError : shapes do not fit, or k < 1.
        """
        u, y = as_record(self, u, y, k)
        W = self.layout.stack(u, y)
        measured = predict(W, self.n_init, int(k), self.layout.lags, self.parameters)
        ahead = self.layout.outputs_of(measured)
        window = full_window(self.n_init, self.dt_s)
        later = window + k - 1
        if self.noise is not None and len(W) > later:
            free = self.simulate(u, estimate_start(self, u[:window], y[:window]))
            ahead[later:] = output_error_ahead(free, y, self.noise, k)[later:]
        return ahead

    def one_step(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, n_y) what the rules conclude from measured lags, eq. (3); NaN in the first n_init rows."""
        W = self._stack(u, y)
        return self.layout.outputs_of(predict(W, self.n_init, 1, self.layout.lags, self.parameters))

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) free run from the first n_init measured outputs.

        When None: from rest, that is with inputs and outputs at zero before the first sample.

        Raises
        ------
        UsageError : shapes do not fit, or fewer than n_init outputs are given.
        """
        result = self._run(self.started(u, y0))
        if y0 is None:
            return result[self.n_init :]
        result[: self.n_init] = as_columns(y0, self.layout.n_y, "y0")[: min(self.n_init, len(result))]
        return result

    @cached_property
    def _free(self) -> Parameters:
        """Parameters of a free run, found once: a search for a start runs many."""
        return unheld(self.layout.lags, self.parameters)

    def unlimited(self) -> FittedTS:
        """The model without its output limits, if it needs none to be bounded: one rule, and stable."""
        return replace(self, parameters=self._free)

    def started(self, u: FloatArray, y0: FloatArray | None) -> FloatArray:
        """W that a run computes, from row n_init on: those before are its start.

        Rows of zeros before the inputs where it starts from rest; raises as `simulate`.
        """
        d = self.n_init
        n_y = self.layout.n_y
        u = as_columns(u, len(self.inputs), "u")
        if y0 is None:
            before = np.concatenate([np.zeros((d, u.shape[1])), u])
            return self.layout.stack(before, np.zeros((d, n_y)))
        given = as_columns(y0, n_y, "y0")
        if len(given) < d:
            raise UsageError(f"{len(given)} measured samples; the model starts from {d}")
        W = self.layout.stack(u, given[: min(d, len(u))])
        if len(u) > d:
            W[:d, :n_y] = estimated_initial(self.initial_gain, W, d, n_y)
        return W

    def _run(self, W: FloatArray) -> FloatArray:
        """(N, n_y) outputs of a free run of W, whose first n_init rows are the start."""
        if len(W) > self.n_init:
            free_run(W, self.n_init, self.layout.lags, self._free)
        return np.asarray(np.clip(self.layout.outputs_of(W), *self.output_limits))

    def firing(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, R) normalised firing strengths along measured data; the first n_init rows repeat the next."""
        return np.asarray(firing(self._stack(u, y), self.n_init, self.layout.lags, self.parameters))

    def rule_outputs(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, R, n_y) what every rule concludes along measured data; NaN in the first n_init rows."""
        W = self._stack(u, y)
        d = self.n_init
        n_y = self.layout.n_y
        result = np.full((len(W), len(self.parameters.theta), n_y), np.nan)
        part = np.einsum("rim,nm->nri", self.parameters.theta, self.layout.regressor_values(W))
        result[d:] = part * self.layout.scale[:n_y] + self.layout.shift[:n_y]
        return result

    def local_polynomials(self) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
        """Per rule (A, B, c): y(k) = sum_j A[j-1] y(k-j) + sum_j B[j] u(k-j) + c, physical units.

        A is (na, n_y, n_y), B is (largest input lag + 1, n_y, n_u), c is (n_y,).
        """
        n_y = self.layout.n_y
        n_u = len(self.inputs)
        deepest = max([0, *(lag for c, lag in self.layout.regressors if c >= n_y)])
        result = []
        for theta in self.consequents:
            A = np.zeros((self.layout.orders.na, n_y, n_y))
            B = np.zeros((deepest + 1, n_y, n_u))
            for m, (c, lag) in enumerate(self.layout.regressors[:-1]):
                if c < n_y:
                    A[lag - 1, :, c] = theta[:, m]
                else:
                    B[lag, :, c - n_y] = theta[:, m]
            result.append((A, B, theta[:, -1].copy()))
        return tuple(result)

    def rules(self) -> tuple[Rule, ...]:
        """Every rule in words."""
        return tuple(self._rule(r, *parts) for r, parts in enumerate(self.local_polynomials()))

    def _rule(self, r: int, A: FloatArray, B: FloatArray, c: FloatArray) -> Rule:
        units = [self.layout.signals[a.column].unit for a in self.layout.antecedents]
        text = ", ".join(
            equation(lagged_name(s.name, 0), self.consequents[r, i, :-1], self.regressor_names[:-1], c[i])
            for i, s in enumerate(self.outputs)
        )
        radius = pole_radius(A)
        return Rule(
            label=f"R{r + 1}",
            condition=condition_in_words(self.partition, r, self.antecedents, units),
            conclusion=text,
            dc_gain=dc_gain(A, B),
            time_constant_s=time_constant(radius, self.dt_s),
            pole_radius=radius,
            support=float(self.support[r]),
            here=self.loudest(r),
            push=self.push(r),
        )

    def __str__(self) -> str:
        """The rules and how they were chosen, in words."""
        count = len(self.parameters.theta)
        title = f"Takagi-Sugeno model, {count} rule{'s' if count > 1 else ''}, {self.layout.orders}"
        return in_words(
            f"{title}, {self.n_parameters} parameters",
            self.rules(),
            self.notes,
            (self.outputs, self.inputs),
            self.operating_points,
        )

    def _stack(self, u: FloatArray, y: FloatArray) -> FloatArray:
        return self.layout.stack(*as_record(self, u, y))

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        layout = self.layout
        p = self.parameters
        return {
            **head_of(self),
            "na": layout.orders.na,
            "nb": list(layout.orders.nb),
            "nk": list(layout.orders.nk),
            "antecedents": [[a.column, a.lag, a.minus] for a in layout.antecedents],
            "shift": layout.shift.tolist(),
            "scale": layout.scale.tolist(),
            "parameters": {name: value.tolist() for name, value in p._asdict().items()},
            "initial_gain": self.initial_gain.tolist(),
            "support": self.support.tolist(),
            "noise": None if self.noise is None else self.noise.tolist(),
            "operating_points": points_as_json(self.operating_points),
            "notes": list(self.notes),
        }

    def explain(self, u: FloatArray, y: FloatArray, row: int) -> Explanation:
        """Which rules spoke at a sample of measured data, how loudly and why; see `explain.explain`."""
        from flysid.model.rules.explanation import explain

        return explain(self, u, y, row)

    def linearise(self, at: Mapping[str, float]) -> StateSpace:
        """The local linear model while every signal stands at a value; see `local.linearise`.

        Parameters
        ----------
        at : signal's name -> value; signals left out stand at their mean in training.

        Raises
        ------
        UsageError : a name that is no signal of the model, a value that is no number, a place at which the
            model's output is at its limit.
        """
        from flysid.model.rules.local_models import linearise

        values = values_at([s.name for s in self.layout.signals], self.layout.shift, at)
        n_y = self.layout.n_y
        return linearise(self, values[n_y:], values[:n_y])

    def outside_share(self, u: FloatArray, y: FloatArray) -> float:
        """Share of samples, 0 to 1, in which an antecedent lies outside the range seen in training."""
        from flysid.model.rules.explanation import outside_share

        return outside_share(self, u, y)

    def polytope(self) -> tuple[StateSpace, ...]:
        """The rules as local state spaces over one common state; see `local.polytope`."""
        from flysid.model.rules.local_models import polytope

        return polytope(self)

    def certificate(self) -> Certificate:
        """What can be proved about the stability of any blend of the rules; see `local.certificate`."""
        from flysid.model.rules.local_models import certificate

        return certificate(self)

    def simplifications(self, train: Dataset) -> list[Simplification]:
        """What could be said more simply, cheapest first; see `simplify.simplifications`."""
        from flysid.model.rules.simplify import simplifications

        return simplifications(self, train)

    def uncertainty(self, train: Dataset) -> RuleUncertainty:
        """How sure the model is of its numbers, from the data that it was fitted to; see `uncertainty`."""
        from flysid.model.rules.rule_uncertainty import uncertainty

        return uncertainty(self, train)

    def to_control(self) -> Any:
        """The model as a `control.NonlinearIOSystem`, which follows `simulate` sample by sample."""
        from flysid.model.rules.control_system import to_nonlinear_system

        return to_nonlinear_system(self)


def refuse_other_models(model: object) -> None:
    """Raises UsageError where a model is not one of rules over lags."""
    if not isinstance(model, FittedTS):
        kind = getattr(model, "structure", type(model).__name__)
        hint = "what rules over hidden states tell are methods of the model; the rest is for TS()"
        raise UsageError(
            f"this is for rules over lags, and the model is {kind!r}",
            hint=hint if kind == "ts_ss" else "fit flysid.TS()",
        )


def values_at(names: Sequence[str], means: FloatArray, at: Mapping[str, float]) -> FloatArray:
    """The mean of every signal, or what `at` says of it.

    Raises
    ------
    UsageError : a name that is none of them, a value that is no finite number.
    """
    for name, value in at.items():
        if name not in names:
            raise UsageError(f"the model has no signal {name!r}", hint=f"one of {', '.join(names)}")
        if not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise UsageError(f"{name}={value!r} is no place to linearise at", hint="give a finite number")
    return np.array([at.get(name, mean) for name, mean in zip(names, means, strict=True)], dtype=float)


def dc_gain(A: FloatArray, B: FloatArray) -> FloatArray:
    """(n_y, n_u) steady gain; NaN where the rule integrates."""
    left = np.eye(B.shape[1]) - A.sum(axis=0)
    if np.linalg.cond(left) > 1e12 or np.abs(left).max() < 1e-12:
        return np.full(B.shape[1:], np.nan)
    return np.asarray(np.linalg.solve(left, B.sum(axis=0)))


def time_constant(radius: float, dt_s: float) -> float:
    """Seconds in which the slowest mode falls to 1/e; inf where it does not fall."""
    if radius >= 1.0 - 1e-9:
        return float("inf")
    return 0.0 if radius <= 0.0 else float(-dt_s / np.log(radius))


def from_dict(document: Mapping[str, Any]) -> FittedTS:
    """Rebuild what `to_dict` gave; raises StoreError where the parts do not fit each other."""
    numbers = {name: np.array(value, dtype=np.float64) for name, value in document["parameters"].items()}
    rules = len(numbers["theta"])
    n_z = len(document["antecedents"])
    numbers["centre"] = numbers["centre"].reshape(rules, n_z)
    numbers["width"] = numbers["width"].reshape(rules, n_z)
    numbers["z_range"] = numbers["z_range"].reshape(2, n_z)
    layout = Layout(
        outputs=signals_of(document, "outputs"),
        inputs=signals_of(document, "inputs"),
        orders=Orders(int(document["na"]), tuple(document["nb"]), tuple(document["nk"])),
        antecedents=tuple(Antecedent(*a) for a in document["antecedents"]),
        shift=np.array(document["shift"], dtype=np.float64),
        scale=np.array(document["scale"], dtype=np.float64),
    )
    model = FittedTS(
        dt_s=float(document["dt_s"]),
        layout=layout,
        parameters=Parameters(**numbers),
        initial_gain=np.array(document["initial_gain"], dtype=np.float64),
        support=np.array(document["support"], dtype=np.float64),
        notes=tuple(document["notes"]),
        noise=array_or_none(document["noise"]),
        operating_points=points_from(document.get("operating_points", ())),
    )
    check(layout, model.parameters, model.noise)
    return model
