"""A fitted Takagi-Sugeno model: what it simulates, predicts, says and stores.

    R_r: If z_1(k) is A_r1 and ... then x(k) = sum_j A_rj x(k-j) + sum_j B_rj u(k-nk-j) + c_r

with the firing strengths and the weighted mean of the paper's eq. (1)-(3) (Takagi and Sugeno, 1985). x holds
the outputs, and hidden states where there are any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.extras import Extra, extra
from flysid.model import own_constants
from flysid.model.arguments import as_columns, as_record, check_start
from flysid.model.base import OperatingPoint, Rule, write_document
from flysid.model.documents import head_of, points_as_json
from flysid.model.noise import output_error_ahead
from flysid.model.own_constants import OwnConstants
from flysid.model.regressors import lagged_name
from flysid.model.rules.free_run_error import widen
from flysid.model.rules.kernel import Parameters, firing, free_run, predict
from flysid.model.rules.likely_start import LikelyStart, RunStart
from flysid.model.rules.memberships import Partition
from flysid.model.rules.operating_words import sentences
from flysid.model.rules.phrases import condition_in_words, equation, in_words, push_in_words
from flysid.model.rules.recursion import Recursion, drop_held, time_constant
from flysid.model.rules.regressor_layout import Layout
from flysid.model.start import FreeRuns, searched_start, start_window
from flysid.showing import counted


@dataclass(frozen=True, eq=False, repr=False)
class RuleModel(FreeRuns):
    """A dynamic TS model; see the laws in flysid.model.base.

    Attributes
    ----------
    layout : signals, hidden states, orders, antecedents, scaling.
    parameters : consequents and memberships in normalised units; limits include ends of travel.
    start : what a run starts from.
    support : (R,) share of training samples for which each rule is the strongest.
    noise : (p + 1, n_y) monic autoregression of the free run's error per output, which predictions lean
        on; None: predictions regress on measured lags.
    operating_points : what the model does where its vehicle rests; () where it never does, or not asked.
    flight_offsets : what flights had beside the model in training; None where all had the same.
    """

    dt_s: float
    layout: Layout
    parameters: Parameters
    start: RunStart
    support: FloatArray
    notes: tuple[str, ...]
    noise: FloatArray | None = None
    operating_points: Sequence[OperatingPoint] = ()
    flight_offsets: OwnConstants | None = None

    @property
    def structure(self) -> str:
        """ "ts" over lags, "ts_ss" over hidden states."""
        return "ts_ss" if self.layout.hidden else "ts"

    @property
    def n_init(self) -> int:
        """Measured samples that start a simulation."""
        return self.start.samples

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """Input signals."""
        return self.layout.inputs

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Output signals."""
        return self.layout.outputs

    @property
    def output_limits(self) -> FloatArray:
        """(2, n_y) range of the training outputs, widened by itself on each side; or ends of travel in it."""
        n = self.layout.n_y
        return np.asarray(self.parameters.limits[:, :n] * self.layout.scale[:n] + self.layout.shift[:n])

    @property
    def trained_range(self) -> FloatArray:
        """(2, n_z) smallest and largest antecedents of the training data, physical units.

        The memberships may go on beyond before they stay as they are.
        """
        reach = self.layout.reach
        return widen(np.stack([self.partition.low, self.partition.high]), -reach / (1.0 + 2.0 * reach))

    # -- runs ----------------------------------------------------------------------------------------------

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) free run from the first n_init measured outputs.

        When None: from rest, that is with inputs and outputs at zero before the first sample.

        Raises
        ------
        UsageError : shapes do not fit, or fewer than n_init outputs are given.
        """
        u = as_columns(u, len(self.inputs), "u")
        if y0 is None:
            W = self.run(u)
            return self.outputs_of(W)[len(W) - len(u) :]
        given = as_columns(y0, self.layout.n_y, "y0")[: self.n_init]
        check_start(len(given), min(self.n_init, len(u)))
        given = given[: len(u)]
        if len(u) <= self.n_init:
            return np.array(given)
        result = self.outputs_of(self.run(u, given))
        result[: self.n_init] = given
        return result

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        """(N, n_y) predictions from outputs at least k steps old; the first n_init + k - 1 rows are NaN.

        A model refined on the simulation error adds to its free run what its noise model foresees, once it
        has seen enough to start that run; lags as they were measured carry their noise into every step.

        Raises
        ------
        UsageError : shapes do not fit, or k < 1.
        """
        u, y = as_record(self, u, y, k)
        hidden = bool(self.layout.hidden)
        ahead = np.full(y.shape, np.nan) if hidden else self._from_lags(u, y, int(k))
        window = self.start.settled(self.dt_s)
        later = window + k - 1
        if (hidden or self.noise is not None) and len(y) > later:
            free = self.run_from_measured(u, y[:window])
            foreseen = free if self.noise is None else output_error_ahead(free, y, self.noise, k)
            ahead[later:] = foreseen[later:]
        return ahead

    def _from_lags(self, u: FloatArray, y: FloatArray, k: int) -> FloatArray:
        """(N, n_y) what the rules conclude k steps ahead of measured lags; NaN where there is nothing yet."""
        layout = self.layout
        W = self.seen(u, y)
        return layout.outputs_of(predict(W, self.n_init, k, layout.lags, self.parameters))

    def one_step(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, n_y) what the rules conclude from measured lags, eq. (3); NaN in the first n_init rows."""
        return self._from_lags(u, y, 1)

    @cached_property
    def free(self) -> Parameters:
        """Parameters of a free run, found once; one stable rule over lags is cut off afterwards.

        Limits of hidden states hold: they may be ends of travel.
        """
        return self.parameters if self.layout.hidden else drop_held(self.layout.lags, self.parameters)

    def unlimited(self) -> Self:
        """The model without its output limits, if it needs none to be bounded: one rule, and stable."""
        return replace(self, parameters=self.free)

    def started(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """W that a run computes, from row `layout.depth` on: those before are its start.

        Rows of zeros before the inputs where it starts from rest.
        """
        u = as_columns(u, len(self.inputs), "u")
        n_y = self.layout.n_y
        if y0 is None:
            rest = self.start.rest(self.layout)
            W = self.layout.stack(np.vstack([np.zeros((rest, u.shape[1])), u]), np.zeros((rest, n_y)))
            known = 0
        else:
            given = as_columns(y0, n_y, "y0")[: len(u)]
            W = self.layout.stack(u, given)
            known = len(given)
        self.start.write(self.layout, self.free, W, known)
        return W

    def run(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """W of the free run from the start that `y0` (M, n_y) suggests, or from rest, rows of zeros first."""
        W = self.started(u, y0)
        if len(W) > self.layout.depth:
            free_run(W, self.layout.depth, self.layout.lags, self.free)
        return W

    def outputs_of(self, W: FloatArray) -> FloatArray:
        """(N, n_y) physical outputs of a run, inside the output limits."""
        return np.asarray(np.clip(self.layout.outputs_of(W), *self.output_limits))

    def run_from_measured(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, n_y) free run from the start that suits the measured first rows y (M, n_y) best."""
        if isinstance(self.start, LikelyStart):
            return self.outputs_of(self.run(u, y))
        return self.simulate(u, searched_start(self, as_columns(u, len(self.inputs), "u")[: len(y)], y))

    def states(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, n) outputs and hidden states (in spreads) of the free run along measured data."""
        y = as_columns(y, self.layout.n_y, "y")
        W = self.run(u, y[: start_window(self.n_init, len(y), self.dt_s)])
        n = self.layout.n
        return np.asarray(W[:, :n] * self.layout.scale[:n] + self.layout.shift[:n])

    def seen(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """W with outputs as measured, hidden states as the free run has them."""
        u, y = as_record(self, u, y)
        W = self.layout.stack(u, y)
        hidden = slice(self.layout.n_y, self.layout.n)
        if self.layout.hidden:
            W[:, hidden] = self.run(u, y[: start_window(self.n_init, len(y), self.dt_s)])[:, hidden]
        return W

    def firing(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, R) normalised firing strengths along measured data; the first rows repeat the next."""
        return np.asarray(firing(self.seen(u, y), self.layout.depth, self.layout.lags, self.parameters))

    def rule_outputs(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, R, n_y) what every rule concludes along measured data; NaN in the first n_init rows."""
        W = self.seen(u, y)
        first = max(self.n_init, self.layout.depth)
        n_y = self.layout.n_y
        theta = self.parameters.theta[:, :n_y]
        result = np.full((len(W), len(theta), n_y), np.nan)
        if len(W) > first:
            x = self.layout.regressor_values(W)[first - self.layout.depth :]
            part = np.einsum("rim,nm->nri", theta, x)
            result[first:] = part * self.layout.scale[:n_y] + self.layout.shift[:n_y]
        return result

    # -- rules ---------------------------------------------------------------------------------------------

    def recursions(self) -> tuple[Recursion, ...]:
        """Every rule by itself over all simulated columns, physical units."""
        columns = len(self.layout.scale)
        return tuple(Recursion.of(self.layout.lags, theta, columns) for theta in self.consequents)

    def local_polynomials(self) -> tuple[Recursion, ...]:
        """Every rule by itself over the outputs, physical units: hidden states are eliminated."""
        found = self.recursions()
        return tuple(r.without_hidden(self.layout.n_y) for r in found) if self.layout.hidden else found

    def rules(self) -> tuple[Rule, ...]:
        """Every rule in words."""
        return tuple(self._rule(r, recursion) for r, recursion in enumerate(self.recursions()))

    def _rule(self, r: int, recursion: Recursion) -> Rule:
        layout = self.layout
        units = [layout.signals[a.column].unit for a in layout.antecedents]
        names = self.regressor_names[:-1]
        text = "; ".join(
            equation(lagged_name(s.name, 0), row[:-1], names, row[-1])
            for s, row in zip(layout.signals, self.consequents[r], strict=False)
        )
        radius = recursion.pole_radius
        return Rule(
            label=f"R{r + 1}",
            condition=condition_in_words(self.partition, r, self.antecedents, units),
            conclusion=text,
            dc_gain=recursion.gain[: layout.n_y],
            time_constant_s=time_constant(radius, self.dt_s),
            pole_radius=radius,
            support=float(self.support[r]),
            here=self.loudest(r),
            push=extra(Extra.PUSH, partial(self.push, r), "", f"R{r + 1}"),
        )

    def loudest(self, rule: int) -> tuple[OperatingPoint, ...]:
        """For every output the operating point, if any, where a rule is the strongest and its loudest."""
        own = [p for p in self.operating_points if int(p.shares.argmax()) == rule]
        best = {p.output: p for p in sorted(own, key=lambda p: float(p.shares[rule]))}
        return tuple(best.values())

    def push(self, rule: int) -> str:
        """What a rule's constant does, in words; "" where there are several signals, or it does little."""
        if len(self.parameters.theta) < 2 or len(self.outputs) > 1 or len(self.inputs) > 1:
            return ""
        with np.errstate(all="ignore"):
            pushes = np.array([float(c[0] / B.sum()) for _, B, c in self.local_polynomials()])
        return push_in_words(pushes, self.support, rule, self.inputs[0], float(self.layout.scale[-1]))

    @property
    def n_parameters(self) -> int:
        """Consequents, and centres and widths where there are several rules."""
        p = self.parameters
        return int(p.theta.size + (2 * p.centre.size if len(p.theta) > 1 else 0))

    @property
    def antecedents(self) -> tuple[str, ...]:
        """Names of the antecedent variables."""
        return tuple(a.name(self.layout.signals) for a in self.layout.antecedents)

    @property
    def regressor_names(self) -> tuple[str, ...]:
        """What the consequents multiply; the last is the constant 1."""
        return self.layout.regressor_names

    @cached_property
    def consequents(self) -> FloatArray:
        """(R, n, n_x) consequents in physical units, in the order of `regressor_names`.

        n counts the outputs; the states, outputs first, where there are hidden ones.
        """
        layout = self.layout
        n = layout.n
        theta = self.parameters.theta * layout.scale[:n][None, :, None]
        columns = np.array([c for c, _ in layout.regressors[:-1]])
        gains = theta[:, :, :-1] / layout.scale[columns]
        offset = theta[:, :, -1] + layout.shift[:n] - gains @ layout.shift[columns]
        return np.concatenate([gains, offset[:, :, None]], axis=2)

    @cached_property
    def partition(self) -> Partition:
        """Memberships in physical units."""
        p = self.parameters
        shift, scale = self.layout.antecedent_scaling()
        width = p.width * scale
        low, high = p.z_range * scale + shift
        return Partition(p.centre * scale + shift, width, width, low, high)

    @property
    def centres(self) -> FloatArray:
        """(R, n_z) centres of the memberships, physical units."""
        return self.partition.centre

    @property
    def widths(self) -> FloatArray:
        """(R, n_z) widths of the memberships, physical units."""
        return self.partition.left

    def memberships(self, variable: int, x: FloatArray) -> FloatArray:
        """(len(x), R) grade of membership of values x of one antecedent (physical units)."""
        return self.partition.grades(variable, x)

    def __str__(self) -> str:
        """The rules and how they were chosen, in words."""
        count = len(self.parameters.theta)
        rules = counted(count, "rule")
        layout = self.layout
        title = f"Takagi-Sugeno model, {rules}, {layout.orders}"
        if self.structure == "ts_ss":
            states = f"{counted(layout.n, 'state')} ({layout.hidden} hidden)"
            title = f"Takagi-Sugeno state-space model, {rules}, {states}"
        title += f", {self.n_parameters} parameters"
        signals = self.outputs, self.inputs
        return in_words(title, self.rules(), self.notes, signals, sentences(self.operating_points, signals))

    # -- storage -------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        layout = self.layout
        return {
            **head_of(self),
            "na": layout.orders.na,
            "nb": list(layout.orders.nb),
            "nk": list(layout.orders.nk),
            "hidden": layout.hidden,
            "reach": layout.reach,
            "antecedents": [[a.column, a.lag, a.minus] for a in layout.antecedents],
            "shift": layout.shift.tolist(),
            "scale": layout.scale.tolist(),
            "parameters": {name: value.tolist() for name, value in self.parameters._asdict().items()},
            **self.start.to_dict(),
            "support": self.support.tolist(),
            "noise": None if self.noise is None else self.noise.tolist(),
            "operating_points": points_as_json(self.operating_points),
            "notes": list(self.notes),
            **own_constants.as_document(self.flight_offsets),
        }

    def save(self, path: str | Path) -> None:
        """Write the model as JSON, whole or not at all."""
        write_document(self.to_dict(), path)


def refuse_other_models(model: object, *, hidden: bool = True) -> None:
    """Raises UsageError where a model is not one of dynamic rules, or has hidden states and must not."""
    if isinstance(model, RuleModel) and (hidden or model.structure == "ts"):
        return
    kind = getattr(model, "structure", type(model).__name__)
    what = "dynamic rules" if hidden else "rules over lags"
    raise UsageError(f"this is for {what}, and the model is {kind!r}", hint="fit flysid.TS(states=0)")
