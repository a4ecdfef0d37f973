"""What flights have beside the model that was fitted to them: numbers that a fitted model carries along."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from flysid.dataset import FloatArray, Signal

FlightOffsets: TypeAlias = bool | Literal["auto"]
"""The setting of a structure: a constant of every flight where flights differ, always or never."""


@dataclass(frozen=True)
class OwnConstants:
    """By flight, what its outputs had beside the inputs' effect in training.

    `values`: by flight, one number per output: a constant in its unit, or a drift in its unit per second.
    `drifting`: per output, whether the numbers are drifts. An output that integrates has these: what is
        constant at its input makes it drift.
    """

    values: Mapping[str, tuple[float, ...]]
    drifting: tuple[bool, ...]

    def spans(self, outputs: Sequence[Signal]) -> list[tuple[Signal, float, float, str]]:
        """Of every output in which flights differ: the least, the largest, and their unit."""
        each = np.array(list(self.values.values()))
        found = zip(outputs, each.min(axis=0), each.max(axis=0), self.drifting, strict=True)
        return [
            (signal, float(low), float(high), f"{signal.unit}{'/s' if drifts else ''}")
            for signal, low, high, drifts in found
            if low != high
        ]

    def to_dict(self) -> dict[str, Any]:
        """As JSON types."""
        return {"values": {k: list(v) for k, v in self.values.items()}, "drifting": list(self.drifting)}


def as_document(constants: OwnConstants | None) -> dict[str, Any]:
    """What a model file holds of them: nothing where there are none."""
    return {} if constants is None else {"flight_offsets": constants.to_dict()}


def from_document(document: Mapping[str, Any], n_y: int) -> OwnConstants | None:
    """What `as_document` wrote. Raises ValueError: not one finite number per output."""
    found = document.get("flight_offsets")
    if found is None:
        return None
    values = {str(k): tuple(map(float, v)) for k, v in dict(found["values"]).items()}
    drifting = tuple(bool(d) for d in found["drifting"])
    if len(drifting) != n_y or not all(len(v) == n_y and np.isfinite(v).all() for v in values.values()):
        raise ValueError("flight_offsets holds no finite number per output")
    return OwnConstants(values, drifting)


def shapes(drifting: tuple[bool, ...], rows: int, dt_s: float) -> FloatArray:
    """(rows, n_y) what a one of every output's number adds to it: one, or the seconds since the start."""
    t = np.arange(rows) * dt_s
    return np.stack([t if drifts else np.ones(rows) for drifts in drifting], axis=1)
