"""One step of a fitted model, as its structure's row makes it (`flysid.model.structures`)."""

from __future__ import annotations

from flysid.errors import UsageError
from flysid.export.other_rate import resample
from flysid.export.program import Program
from flysid.model.base import Fitted
from flysid.model.structures import row_of
from flysid.offers import import_name


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
    row = row_of(model.structure)
    if not row.program:
        of = f": the package {row.package!r} has no exporter for it" if row.package else ""
        raise UsageError(
            f"a model of structure {model.structure!r} cannot be exported{of}",
            hint="export a member of an ensemble, or a model of one of flysid's own other structures",
        )
    if rate_hz is not None:
        model = resample(model, rate_hz)
    program: Program = import_name(row.program)(model)
    return program
