"""Fitted Takagi-Sugeno models with all that they offer; how they are built and read from files.

The kernels do not check bounds: a forged column or lag would read memory that is not theirs. So what is read
from a file is checked before compiled code follows its indices. python-control is imported only when a
system of it is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import StoreError
from flysid.model import own_constants
from flysid.model.base import MAX_SIGNALS
from flysid.model.documents import array_or_none, monic, points_from, signals_of
from flysid.model.rules import edits, explanation, local_models, rule_uncertainty
from flysid.model.rules.edits import PricedEdit
from flysid.model.rules.explanation import Explanation
from flysid.model.rules.growth import rule_support
from flysid.model.rules.kernel import Parameters, free_run
from flysid.model.rules.likely_start import LikelyStart, MeasuredStart, Prior, RunStart
from flysid.model.rules.local_models import LocalStateSpace
from flysid.model.rules.lyapunov import StabilityCertificate, certificate_of
from flysid.model.rules.recursion import companion
from flysid.model.rules.refit import start_of, with_noise_model
from flysid.model.rules.regressor_layout import REACH, Antecedent, Layout, Orders
from flysid.model.rules.rule_model import RuleModel
from flysid.model.rules.rule_uncertainty import Uncertainty
from flysid.model.rules.stages import Stage

MAX_LAG = 10_000


class FittedTS(RuleModel):
    """A dynamic TS model over lags, or over hidden states; see `RuleModel` for what it holds."""

    def explain(self, u: FloatArray, y: FloatArray, row: int) -> Explanation:
        """Which rules spoke at a sample of measured data, how loudly and why."""
        return explanation.explain(self, u, y, row)

    def outside_share(self, u: FloatArray, y: FloatArray) -> float:
        """Share of samples, 0 to 1, in which an antecedent lies outside the range seen in training."""
        return explanation.outside_share(self, u, y)

    def linearise(self, at: Mapping[str, float]) -> LocalStateSpace:
        """The local linear model while every signal stands at a value; see `local_models.linearise`.

        Parameters
        ----------
        at : signal's name -> value; signals left out stand at their mean in training.
        """
        return local_models.linearise(self, at)

    def polytope(self) -> tuple[LocalStateSpace, ...]:
        """The rules as local state spaces over one common state."""
        return local_models.polytope(self)

    def certificate(self) -> StabilityCertificate:
        """What can be proved about the stability of any blend of the rules."""
        return certificate_of([companion(rule.A) for rule in self.recursions()])

    def simplifications(self, train: Dataset) -> list[PricedEdit]:
        """What could be said more simply, cheapest first; of rules over lags."""
        return edits.simplifications(self, train)

    def uncertainty(self, train: Dataset) -> Uncertainty:
        """How sure the model is of its numbers, from the data that it was fitted to."""
        return rule_uncertainty.uncertainty(self, train)

    def to_control(self) -> Any:
        """The model as a `control.NonlinearIOSystem`, which follows `simulate` sample by sample."""
        return to_nonlinear_system(self)


def finish(stage: Stage, train: Dataset, notes: tuple[str, ...]) -> FittedTS:
    """The stage as a fitted model, with its start, support and noise model."""
    parameters = stage.problem.parameters(stage.body)
    start = start_of(stage, train.dt_s)
    bare = FittedTS(train.dt_s, stage.layout, parameters, start, rule_support(stage), notes)
    return with_noise_model(bare, train)


def from_dict(document: Mapping[str, Any]) -> FittedTS:
    """Rebuild what `to_dict` gave; raises StoreError where the parts do not fit each other."""
    numbers = {name: np.array(value, dtype=np.float64) for name, value in document["parameters"].items()}
    rules = len(numbers["theta"])
    n_z = len(document["antecedents"])
    for name, shape in (("centre", (rules, n_z)), ("width", (rules, n_z)), ("z_range", (2, n_z))):
        numbers[name] = numbers[name].reshape(shape)
    early = "input_lags" in document  # as 0.1.0 wrote hidden states
    layout = Layout(
        outputs=signals_of(document, "outputs"),
        inputs=signals_of(document, "inputs"),
        orders=_orders(document["input_lags"]) if early else _orders_of(document),
        antecedents=tuple(Antecedent(*a) for a in document["antecedents"]),
        shift=np.array(document["shift"], dtype=np.float64),
        scale=np.array(document["scale"], dtype=np.float64),
        hidden=int(document.get("hidden", 0)),
        reach=float(document.get("reach", 0.0 if early else REACH)),
    )
    model = FittedTS(
        dt_s=float(document["dt_s"]),
        layout=layout,
        parameters=Parameters(**numbers),
        start=_start(document, layout),
        support=np.array(document["support"], dtype=np.float64),
        notes=tuple(str(note) for note in document["notes"]),
        noise=array_or_none(document["noise"]),
        operating_points=points_from(document.get("operating_points", ())),
        flight_offsets=own_constants.from_document(document, len(layout.outputs)),
    )
    check(layout, model.parameters, model.noise)
    return model


def _orders_of(document: Mapping[str, Any]) -> Orders:
    return Orders(int(document["na"]), tuple(document["nb"]), tuple(document["nk"]))


def _orders(input_lags: list[list[int]]) -> Orders:
    orders = Orders.of_states(input_lags)
    if [list(lags) for lags in orders.input_lags] != input_lags:
        refuse("input lags that do not follow each other")
    return orders


def _start(document: Mapping[str, Any], layout: Layout) -> RunStart:
    if "initial_gain" in document:
        return MeasuredStart(np.array(document["initial_gain"], dtype=np.float64), layout.depth)
    known = document["prior"]
    q = layout.moving * layout.n
    mean = np.array(known["mean"], dtype=np.float64).reshape(q)
    weight = float(known["weight"])
    if "root" in known:
        prior = Prior(mean, np.array(known["root"], dtype=np.float64).reshape(q, q), weight)
    else:  # as 0.1.0 wrote hidden states
        prior = Prior.of_inverse(mean, np.array(known["inverse"], dtype=np.float64).reshape(q, q), weight)
    return LikelyStart(prior, int(document["n_init"]))


def check(layout: Layout, parameters: Parameters, noise: FloatArray | None) -> None:
    """Orders, antecedents, scaling and shapes of a dynamic TS model.

    Raises
    ------
    StoreError : one is out of its range, or does not fit the others.
    ValueError : a noise model that does not begin with 1.
    """
    orders = layout.orders
    n_u = len(layout.inputs)
    n_y = layout.n_y
    n = layout.n
    _require(n_y >= 1 and 0 <= layout.hidden <= MAX_SIGNALS, "states out of range")
    _require(not layout.hidden or orders.na == 1, "hidden states with lags")
    _require(len(orders.nb) == len(orders.nk) == n_u, "orders that do not fit the signals")
    _require(all(_is_lag(value, 0) for value in (orders.na, *orders.nb, *orders.nk)), "orders out of range")
    _require(0.0 <= layout.reach < np.inf, "a reach out of range")
    _check_antecedents(layout.antecedents, n, n + n_u, layout.orders.depth if layout.hidden else MAX_LAG)
    _check_scaling(layout.shift, layout.scale, n + n_u)
    _check_parameters(parameters, (n, n * orders.na + sum(orders.nb) + 1, len(layout.antecedents)))
    if noise is not None:
        _check_noise(noise, n_y)


def _check_antecedents(antecedents: Sequence[Antecedent], states: int, columns: int, most: int) -> None:
    """Columns below `columns`; past values of the first `states` of them, present ones of the others."""
    for a in antecedents:
        _require(_is_lag(a.column, 0) and a.column < columns, "an antecedent of no signal")
        least = 1 if a.column < states else 0
        _require(_is_lag(a.lag, least) and a.lag <= most, "an antecedent's lag out of range")
        _require(
            a.minus == -1 or (_is_lag(a.minus, least) and a.minus <= most), "an antecedent's lag out of range"
        )


def _check_scaling(shift: FloatArray, scale: FloatArray, n: int) -> None:
    _require(shift.shape == scale.shape == (n,) and bool((scale > 0.0).all()), "a scaling of another size")


def _check_parameters(p: Parameters, sizes: tuple[int, int, int]) -> None:
    """Shapes for (outputs, regressors, antecedents)."""
    n, n_x, n_z = sizes
    rules = len(p.theta)
    _require(rules > 0, "no rules")
    wanted = ((rules, n, n_x), (rules, n_z), (rules, n_z), (2, n_z), (2, n))
    for name, array, shape in zip(p._fields, p, wanted, strict=True):
        fits = array.shape == shape and array.flags.c_contiguous
        _require(fits, f"{name} of shape {array.shape}, not {shape}")


def _check_noise(noise: FloatArray, n_y: int) -> None:
    _require(noise.ndim == 2 and noise.shape[1] == n_y, "a noise model of another size")
    _require(bool(np.isfinite(noise).all()), "a noise model that is not finite")
    monic(noise, "noise")


def _require(holds: bool, fault: str) -> None:
    if not holds:
        refuse(fault)


def refuse(fault: str) -> NoReturn:
    """Raise StoreError for a model file whose parts do not fit each other."""
    raise StoreError(f"damaged model file: {fault}", hint="fit again")


def _is_lag(value: object, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= MAX_LAG


def next_step(model: RuleModel, s: FloatArray, u: FloatArray) -> FloatArray:
    """(n,) x(k) from u(k) and s(k): x(k-1), ..., x(k-`layout.moving`), u(k-1), ..., u(k-`layout.depth`)."""
    layout = model.layout
    n = layout.n
    d = layout.depth
    own = layout.moving * n
    W = np.zeros((d + 1, len(layout.scale)))
    W[d - layout.moving : d, :n] = np.asarray(s[:own]).reshape(-1, n)[::-1]
    W[:, n:] = np.vstack([np.asarray(s[own:]).reshape(d, -1)[::-1], np.atleast_1d(u)])
    W = (W - layout.shift) / layout.scale
    free_run(W, d, layout.lags, model.free)
    return np.asarray(W[d, :n] * layout.scale[:n] + layout.shift[:n])


def to_nonlinear_system(model: RuleModel) -> Any:
    """The model as a discrete `control.NonlinearIOSystem` with the state s(k) of `next_step`, physical units.

    Driven by the same inputs from the same past it follows `simulate` sample by sample.
    """
    import control

    n = model.layout.n
    own = model.layout.moving * n
    n_u = len(model.inputs)

    def output(_t: float, s: FloatArray, u: FloatArray, _params: Any) -> FloatArray:
        return np.asarray(np.clip(next_step(model, s, u)[: model.layout.n_y], *model.output_limits))

    def step(_t: float, s: FloatArray, u: FloatArray, _params: Any) -> FloatArray:
        x = np.concatenate([next_step(model, s, u), s[:own]])[:own]
        return np.concatenate([x, np.atleast_1d(u), s[own : len(s) - n_u]])

    return control.NonlinearIOSystem(
        step,
        output,
        inputs=[s.name for s in model.inputs],
        outputs=[s.name for s in model.outputs],
        states=own + model.layout.depth * n_u,
        dt=model.dt_s,
        name="takagi_sugeno",
    )
