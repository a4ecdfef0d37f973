"""A stretch of a flight: what its instruments measured, on one clock."""

from __future__ import annotations

from dataclasses import dataclass

from flysid.sixdof.cleaning import BoolArray, runs
from flysid.stretch import FloatArray

LEAST_S = 1.0
"""A shorter stretch tells nothing."""


@dataclass(frozen=True, eq=False)
class Record:
    """A stretch of a flight on one clock, in axes forward, left, up.

    Attributes
    ----------
    commands : (N, motors) shares of full scale.
    voltage : (N,) V, averaged over a second; None where it is not measured.
    gyro, force, velocity, position : (N, 3); attitude : (N, 4); None where not measured.
    lost : (N,) samples whose telemetry is damaged.
    flying : (N,) samples in the air whose telemetry is whole.
    """

    flight: str
    dt_s: float
    commands: FloatArray
    voltage: FloatArray | None
    gyro: FloatArray
    force: FloatArray | None
    attitude: FloatArray | None
    velocity: FloatArray | None
    position: FloatArray | None
    lost: BoolArray
    flying: BoolArray

    def __len__(self) -> int:
        return len(self.commands)

    @property
    def stretches(self) -> list[tuple[int, int]]:
        """(first, behind the last) of every whole stretch in the air of at least a second."""
        least = round(LEAST_S / self.dt_s)
        return [(a, b) for a, b in runs(self.flying) if b - a >= least]
