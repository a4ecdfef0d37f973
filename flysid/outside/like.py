"""The signals of a model from outside beside those of the data: order, names, units."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.ingest.formats.common.units import factor
from flysid.model.base import Fitted

UNNAMED = re.compile(r"([uy](\(?\d*\)?|\[\d+\]))?")
"""What MATLAB and python-control call signals that nobody named."""


@dataclass(frozen=True)
class Like:
    """What a model has to be a model of."""

    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]

    @classmethod
    def of(cls, model: Fitted) -> Like:
        """The signals and the sample time of a fitted model."""
        return cls(model.dt_s, model.inputs, model.outputs)

    @property
    def words(self) -> str:
        """ "2 inputs and 1 output (theta_in, phi_in; v_x)"."""
        names = "; ".join(", ".join(s.name for s in side) for side in (self.inputs, self.outputs))
        return f"{len(self.inputs)} and {len(self.outputs)} ({names})"


@dataclass(frozen=True, eq=False)
class Matched:
    """Where the data's signals stand in the model.

    `order`: of every signal of the data, its column in the model.
    `factors`: value in the model's unit = factor * value in the data's.
    """

    order: list[int]
    factors: FloatArray
    notes: tuple[str, ...]


def match(ours: Sequence[Signal], names: Sequence[str], units: Sequence[str], side: str) -> Matched:
    """Match by name; by place where nobody named the model's signals.

    Raises UsageError: other names, or units that cannot be converted.
    """
    theirs = [""] * len(ours) if len(names) != len(ours) else list(names)
    wanted = [s.name for s in ours]
    by_place = all(UNNAMED.fullmatch(name) for name in theirs)
    if not by_place and sorted(theirs) != sorted(wanted):
        raise UsageError(
            f"the model's {side}s are {', '.join(theirs)}, the data's {', '.join(wanted)}",
            hint="name them alike in the file, or leave them unnamed and in the data's order",
        )
    order = list(range(len(ours))) if by_place else [theirs.index(name) for name in wanted]
    notes: list[str] = []
    factors = np.ones(len(ours))
    for j, signal in enumerate(ours):
        unit = units[order[j]] if len(units) == len(ours) else ""
        if not unit:
            notes.append(f"No unit was stated for {signal.name}; taken as {signal.unit or 'a plain number'}.")
            continue
        try:
            factors[j] = factor(signal.unit, unit)
        except UsageError as error:
            raise UsageError(
                f"the model has {signal.name} in {unit!r}, the data in {signal.unit!r}: {error.message}",
                hint="state the data's unit in the file, or leave it empty if it means the same",
            ) from error
        if factors[j] != 1.0:
            notes.append(f"{signal.name} was converted between {signal.unit} and {unit}.")
    return Matched(order, factors, tuple(notes))
