"""One step of a fitted model, as its structure's row makes it (`flysid.model.structures`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.export.program import Program
from flysid.model.base import Fitted
from flysid.model.capabilities import HasMembers, HasOtherRates
from flysid.model.structures import row_of
from flysid.offers import import_name


class Member(NamedTuple):
    """A program, and what it weighs among others: outputs are their weighted sum, shares sum to 1."""

    program: Program
    share: float


def program_of(model: Fitted, rate_hz: float | None = None) -> Program:
    """One step of a fitted model.

    `rate_hz`: steps a second, of a transfer function in s; None is the rate that it was fitted at.
    Raises UsageError: a structure that cannot be exported, or not at another rate; a model without inputs.
    """
    if not model.inputs:
        raise UsageError("the model has no inputs", hint="fit a channel with an input")
    row = row_of(model.structure)
    if not row.program:
        of = f": the package {row.package!r} has no exporter for it" if row.package else ""
        raise UsageError(
            f"a model of structure {model.structure!r} cannot be exported{of}",
            hint="export a model of one of flysid's own other structures; of an ensemble a member, or all "
            "with --casadi, --jax or --onnx",
        )
    if rate_hz is not None:
        model = _resample(model, rate_hz)
    program: Program = import_name(row.program)(model)
    return program


def _resample(model: Fitted, rate_hz: float) -> Fitted:
    """The model at `rate_hz` steps a second, its inputs constant between samples.

    Raises UsageError: a model that has one rate only, one that drifts by itself, or no possible rate.
    """
    if not (np.isfinite(rate_hz) and rate_hz > 0.0):
        raise UsageError(f"a rate of {rate_hz!r} Hz", hint="steps a second, above 0")
    if abs(rate_hz * model.dt_s - 1.0) < 1e-9:
        return model
    if not isinstance(model, HasOtherRates):
        raise UsageError(
            f"a model of structure {model.structure!r} runs at {1.0 / model.dt_s:g} Hz only",
            hint="fit a transfer function in s ('flysid fit -m tf'), or leave out --rate",
        )
    return model.at_rate(rate_hz)


def members_of(model: Fitted, rate_hz: float | None = None) -> tuple[Member, ...]:
    """One step of a fitted model as weighed programs: those of an ensemble's members, or its own alone.

    Raises UsageError: as `program_of`, of any member.
    """
    if not isinstance(model, HasMembers):
        return (Member(program_of(model, rate_hz), 1.0),)
    share = 1.0 / len(model.members)
    inner = [m for member in model.members for m in members_of(member, rate_hz)]
    return tuple(Member(m.program, share * m.share) for m in inner)


def rest_of(members: Sequence[Member]) -> FloatArray:
    """(m,) the memories of all programs at rest, one behind another, in physical units."""
    return np.concatenate([m.program.remembered(m.program.start) for m in members])


def limits_of(members: Sequence[Member]) -> FloatArray:
    """(2, n_y) lowest and highest output that the weighed programs return."""
    return np.asarray(sum(m.share * m.program.output_limits for m in members))
