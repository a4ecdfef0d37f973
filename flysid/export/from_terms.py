"""A polynomial NARX model as a program: every step works out its factors and their products."""

from __future__ import annotations

import numpy as np

from flysid.export.program import Place, Program, Worked
from flysid.model.narx.fitted_polynomial import FittedPolyNARX
from flysid.model.narx.polynomial_terms import Factor, Form
from flysid.model.rules.kernel import Lags
from flysid.showing import counted


def polynomial_program(model: FittedPolyNARX) -> Program:
    """One regressor a term, in the model's order: sums are rounded as its free run rounds them."""
    n_y = len(model.outputs)
    units = model.units
    terms, coefficients = model.everywhere
    worked: dict[Worked, Place] = {}

    def placed(what: Worked) -> Place:
        return worked.setdefault(what, (len(units.scale) + len(worked), 0))

    def formed(place: Place, form: Form) -> Place:
        return place if form == "plain" else placed(Worked(form, place))

    def value_of(factor: Factor, is_free: bool) -> Place:
        place = (factor.column, factor.lag)
        if factor.change:
            place = placed(Worked("change", place, (factor.column, factor.lag + 1)))
        whole = formed(place, factor.form)
        if is_free or model.seen is None or factor.form == "sign":
            return whole
        inside = formed(placed(Worked("held", place, (-1, 0), *model.seen.of_factor(factor))), factor.form)
        return placed(Worked("change", whole, inside)) if factor.excess else inside

    regressors: list[Place] = []
    for term in terms:
        place, *others = [value_of(f, term.is_linear) for f in term.factors] or [(-1, 0)]
        for other in others:
            place = placed(Worked("product", place, other))
        regressors.append(place)
    theta = np.zeros((1, n_y, len(terms)))
    theta[0, [t.equation for t in terms], range(len(terms))] = coefficients
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
