"""Rules made stable on request: by themselves, or with a certificate that any blend of them is.

A rule may have a pole outside the unit circle where the others keep the blend in its range; a controller that
is designed rule by rule, or a proof that holds for any blend of rules, cannot use such a rule. Made stable,
it is drawn towards the mean of all rules, weighted by support, only as far as is needed. Its poles are held
there, and what is left of the model (what inputs and the constant weigh, memberships) is refined on the
simulation error again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.model.polynomials import NEARLY_ONE, ROUNDING
from flysid.model.rules.boundedness import is_bounded
from flysid.model.rules.consequents import refuse_few, refuse_other_data
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.growth import best_started, holds_integrator, whitening
from flysid.model.rules.lyapunov import certificate_of
from flysid.model.rules.operating_points import describe
from flysid.model.rules.phrases import from_to
from flysid.model.rules.recursion import Recursion, companion, rule_radius
from flysid.model.rules.refit import as_problem, at_stage, free_run_rmse
from flysid.model.rules.regressor_layout import Layout, runs_of
from flysid.model.rules.search_settings import RuleSettings
from flysid.model.rules.stages import Stage, ordered
from flysid.model.threads import on_one_thread


@on_one_thread
def with_stable_rules(
    model: FittedTS, train: Dataset, *, largest: float = NEARLY_ONE, certified: bool = False
) -> FittedTS:
    """The model with every rule's poles within `largest`; itself where they are.

    Parameters
    ----------
    train : data on which the rest is refined.
    largest : pole radius, below 1.
    certified : all rules are drawn together until they have a common quadratic Lyapunov function.

    Raises
    ------
    UsageError : a radius outside (0, 1); rules that hold an integrator; data with other signals.
    DataError : no segment is long enough; no more samples than the model has numbers.
    FitError : the mean of all rules is itself beyond that radius: nothing is there to draw them to.

    Examples
    --------
    >>> model = flysid.TS(rules=1, na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> flysid.with_stable_rules(model, train) is model  # its one pole, 0.9, is inside already
    True
    """
    refuse_other_data(model, train)
    if not 0.0 < largest < 1.0:
        raise UsageError(f"largest={largest!r}", hint="give a pole radius between 0 and 1")
    theta = model.parameters.theta
    layout = model.layout
    if holds_integrator(theta, layout.orders.na):
        raise UsageError("the process integrates: every rule has a pole at one, and none can be stable")

    def holds(candidate: FloatArray) -> bool:
        rules = [Recursion.of(layout.lags, rule, len(layout.scale)) for rule in candidate]
        return all(rule.pole_radius <= largest for rule in rules) and (
            not certified or certificate_of([companion(rule.A) for rule in rules]).proved
        )

    if holds(theta):
        return model
    runs = runs_of(layout, train.segments, model.n_init + 2)
    if not runs:
        raise DataError(f"no segment is longer than {model.n_init + 1} samples", hint="record longer")
    refuse_few(sum(len(W) - model.n_init for W in runs), theta[:, 0].size)
    drawn = _drawn(theta, model.support, holds, layout, largest)
    stage = _refine(model, drawn, runs)
    found = at_stage(model, ordered(stage), train)
    told = replace(found, notes=(*model.notes, _told(model, found, train, certified=certified)))
    return describe(told, train)


def _told(model: FittedTS, found: FittedTS, train: Dataset, *, certified: bool) -> str:
    before, after = (max(rule.pole_radius for rule in m.rules()) for m in (model, found))
    old, new = (free_run_rmse(m, train) for m in (model, found))
    steps = from_to(old, new, model.outputs)
    how = "Made stable, provably for any blend of rules" if certified else "Made stable"
    return (
        f"{how}: the largest pole radius of a rule was {before:.5f} and is {after:.5f}; the rest was refined "
        f"again, free run on the training data {steps}."
    )


def _drawn(
    theta: FloatArray,
    support: FloatArray,
    holds: Callable[[FloatArray], bool],
    layout: Layout,
    largest: float,
) -> FloatArray:
    """(R, n_y, n_x) consequents nearest to what they were, on the way to their mean.

    First the rules that are beyond the radius by themselves, each as far as it needs; then, where that does
    not do, all of them alike.
    """
    share = np.maximum(support, 1e-3)
    mean = np.tensordot(share / share.sum(), theta, axes=1)
    if not holds(mean[None]):
        raise FitError(
            f"the mean of all rules has poles beyond {largest:g} itself, so there is no stable model to "
            "move the rules towards",
            hint="fit fewer rules, lower orders, or a linear model with stable=True",
        )
    alone = np.stack(
        [_nearest(rule, mean, lambda r: rule_radius(layout.lags, r) <= largest) for rule in theta]
    )
    return alone if holds(alone) else _nearest(alone, mean, holds)


def _nearest(start: FloatArray, mean: FloatArray, holds: Callable[[FloatArray], bool]) -> FloatArray:
    """The point on the line from `mean`, which holds, to `start` that is the last that was found to hold."""
    if holds(start):
        return start
    inside = 0.0
    outside = 1.0
    while outside - inside > ROUNDING:
        middle = 0.5 * (inside + outside)
        if holds(mean + middle * (start - mean)):
            inside = middle
        else:
            outside = middle
    return np.asarray(mean + inside * (start - mean))


def _refine(model: FittedTS, theta: FloatArray, runs: tuple[FloatArray, ...]) -> Stage:
    """The drawn rules with everything but their poles refined; as drawn where nothing got better."""
    layout = model.layout
    past = np.array([0 <= column < layout.n_y for column, _ in layout.regressors])
    basis = np.zeros((len(past), len(past)))
    X = np.vstack([layout.regressor_values(W) for W in runs])
    for block in (past, ~past):
        basis[np.ix_(block, block)] = whitening(X[:, block])
    problem, body = as_problem(layout, model.parameters._replace(theta=theta), runs, basis)
    start = best_started(problem, body)
    held = np.flatnonzero(np.tile(past, body.a.size // len(past)))
    found = start.refined(RuleSettings.iterations, 1e-6, np.setdiff1d(body.free, held))
    return found if found.cost < start.cost and is_bounded(found) else start
