"""Which structure becomes a program in which way."""

from __future__ import annotations

from flysid.errors import UsageError
from flysid.export.from_linear import linear_program, state_space_program
from flysid.export.from_physics import multirotor_program
from flysid.export.from_rules import program_of_rules, static_program
from flysid.export.from_terms import polynomial_program
from flysid.export.other_rate import resample
from flysid.export.program import Program
from flysid.model.base import Fitted
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.multirotor import FittedMultirotor
from flysid.model.narx.fitted_polynomial import FittedPolyNARX
from flysid.model.rules.fitted import FittedTS
from flysid.model.static_ts import FittedStaticTS
from flysid.model.subspace.fitted_model import FittedStateSpace


def program_of(model: Fitted, rate_hz: float | None = None) -> Program:
    """One step of a fitted model.

    Parameters
    ----------
    rate_hz : steps a second, of a transfer function in s; None is the rate that it was fitted at.

    Raises
    ------
    UsageError : a structure that cannot be exported, or not at another rate; a model without inputs.
    """
    if not model.inputs:
        raise UsageError("the model has no inputs", hint="fit a channel with an input")
    if rate_hz is not None:
        model = resample(model, rate_hz)
    if isinstance(model, FittedLinear):
        return linear_program(model)
    if isinstance(model, FittedStateSpace):
        return state_space_program(model)
    if isinstance(model, FittedTS):
        return program_of_rules(model)
    if isinstance(model, FittedStaticTS):
        return static_program(model)
    if isinstance(model, FittedMultirotor):
        return multirotor_program(model)
    if isinstance(model, FittedPolyNARX):
        return polynomial_program(model)
    raise UsageError(
        f"a model of structure {model.structure!r} cannot be exported",
        hint="export a member of an ensemble, or a model of one of flysid's own other structures",
    )
