"""A polynomial NARX model as a program: every step works out its factors and their products."""

from __future__ import annotations

import numpy as np

from flysid.export.program import Operation, Place, Program, Worked
from flysid.model.narx.fitted_polynomial import FittedPolyNARX
from flysid.model.narx.polynomial_terms import Factor
from flysid.model.rules.kernel import Lags
from flysid.showing import counted


def polynomial_program(model: FittedPolyNARX) -> Program:
    """One regressor a term, in the model's order: sums are rounded as its free run rounds them."""
    n_y = len(model.outputs)
    units = model.units
    worked: dict[Worked, Place] = {}

    def told(operation: Operation, a: Place, b: Place = (-1, 0)) -> Place:
        return worked.setdefault(Worked(operation, a, b), (len(units.scale) + len(worked), 0))

    def value_of(factor: Factor) -> Place:
        place = (factor.column, factor.lag)
        if factor.change:
            place = told("change", place, (factor.column, factor.lag + 1))
        return place if factor.form == "plain" else told(factor.form, place)

    regressors: list[Place] = []
    for term in model.terms:
        place, *others = [value_of(f) for f in term.factors] or [(-1, 0)]
        for other in others:
            place = told("product", place, other)
        regressors.append(place)
    theta = np.zeros((1, n_y, len(model.terms)))
    theta[0, [t.equation for t in model.terms], range(len(model.terms))] = model.theta
    columns, lags = np.array(regressors, dtype=np.int64).T
    none = np.zeros(0, dtype=np.int64)
    return Program(
        title=f"Polynomial NARX model, {counted(len(model.terms), 'term')}",
        dt_s=model.dt_s,
        inputs=model.inputs,
        outputs=model.outputs,
        states=model.outputs,
        lags=Lags(columns, lags, none, none, none),
        theta=theta,
        memberships=None,
        limits=model.limits,
        shift=units.origin,
        scale=units.scale,
        output_limits=model.output_limits,
        rest=np.repeat((-units.origin / units.scale)[:, None], max(model.n_init, 1), axis=1),
        worked=tuple(worked),
    )
