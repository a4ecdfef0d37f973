"""Where a model still answers strongly, and nothing measured says how the vehicle does: beyond coherence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import is_dataclass, replace
from typing import TypeVar

import numpy as np

from flysid.dataset import Dataset
from flysid.model.base import Fitted
from flysid.model.rules.explanation import CAUTION
from flysid.showing import number
from flysid.validate.diagnose.residuals import ResidualSpectrum, spectrum
from flysid.validate.diagnose.responses import responses

M = TypeVar("M", bound=Fitted)
HALF_POWER = np.sqrt(0.5)


def beyond(
    model: Fitted, seen: Sequence[ResidualSpectrum | None], output: int
) -> Iterator[tuple[int, float]]:
    """Inputs, and up to how many Hz they explain an output, above which the model still answers strongly.

    Strongly is with half the power of its largest answer where the input explains the output.

    `seen`: measured responses of every input to the output.
    """
    for j, measured in enumerate(seen):
        end = None if measured is None else measured.explained_to_hz
        if measured is None or end is None:
            continue
        hz = np.append(measured.hz, 0.5 / model.dt_s)
        gains = [np.abs(g) for g in responses(model, hz, output, j)]
        if not gains or not np.isfinite(gains).all():
            continue
        largest = np.max(gains, axis=0)
        above = hz > end
        if largest[above].max() > HALF_POWER * largest[~above].max() > 0.0:
            yield j, end


def caution(model: M, train: Dataset) -> M:
    """The model with a note on every input and output for which it answers beyond what training explains."""
    told = []
    for i, output in enumerate(model.outputs):
        y = [s.y[:, i] for s in train.segments]
        seen = [
            spectrum([s.u[:, j] for s in train.segments], y, model.dt_s) for j in range(len(model.inputs))
        ]
        told += [
            f"{CAUTION} the training flights explain {output.name} by {model.inputs[j].name} up to "
            f"{number(end)} Hz, and the model still responds strongly above that: do not use its gain there."
            for j, end in beyond(model, seen, i)
        ]
    if not told or not is_dataclass(model):
        return model
    return replace(model, notes=(*model.notes, *told))
