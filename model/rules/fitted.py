"""Fitted Takagi-Sugeno models with all that can be asked of them; how they are built and read from files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.model.documents import array_or_none, points_from, signals_of
from flysid.model.rules import control_system, explanation, local_models, rule_uncertainty, simplify
from flysid.model.rules.assembly import start_of, with_noise_model
from flysid.model.rules.explanation import Explanation
from flysid.model.rules.growth import rule_support
from flysid.model.rules.integrity import check, refuse
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.likely_start import Prior
from flysid.model.rules.local_models import LocalStateSpace
from flysid.model.rules.lyapunov import StabilityCertificate, certificate_of
from flysid.model.rules.recursion import companion
from flysid.model.rules.regressor_layout import REACH, Antecedent, Layout, Orders
from flysid.model.rules.rule_model import RuleModel
from flysid.model.rules.rule_uncertainty import Uncertainty
from flysid.model.rules.run_start import LikelyStart, MeasuredStart, RunStart
from flysid.model.rules.simplify import PricedEdit
from flysid.model.rules.stages import Stage


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
        return simplify.simplifications(self, train)

    def uncertainty(self, train: Dataset) -> Uncertainty:
        """How sure the model is of its numbers, from the data that it was fitted to."""
        return rule_uncertainty.uncertainty(self, train)

    def to_control(self) -> Any:
        """The model as a `control.NonlinearIOSystem`, which follows `simulate` sample by sample."""
        return control_system.to_nonlinear_system(self)


def finished(stage: Stage, train: Dataset, notes: tuple[str, ...]) -> FittedTS:
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
