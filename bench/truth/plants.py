"""Linear plants of many kinds, drawn at random, and what an endless noise-free record of them would show."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.frequency.rational import Rational
from flysid.model.frequency.sampling import sample, sampled_response
from flysid.model.polynomials import ComplexArray

KINDS = (
    "first order",
    "second order",
    "light damping",
    "third order",
    "fifth order",
    "dead time",
    "integrating",
    "non-minimum phase",
)
GRID = 40_000
"""Frequencies on which a truth is read off."""


@dataclass(frozen=True, eq=False)
class Plant:
    """One plant: its kind, its transfer function, the frequency (rad/s) around which it was drawn."""

    kind: str
    transfer: Rational
    corner: float

    @property
    def gain(self) -> float | None:
        """Steady gain; None where it integrates."""
        bottom = float(self.transfer.denominator[-1])
        return float(self.transfer.numerators[0][-1]) / bottom if bottom else None

    def response(self, omega: FloatArray, dt_s: float) -> ComplexArray:
        """(F,) behind its hold, as a record shows it."""
        return np.asarray(sampled_response(self.transfer, omega, dt_s, "zero")[:, 0])

    def scaled(self, factor: float) -> Plant:
        """The plant with another gain."""
        tops = tuple(factor * top for top in self.transfer.numerators)
        return replace(self, transfer=replace(self.transfer, numerators=tops))

    def delayed(self, late_s: float) -> Plant:
        """The plant with that much more dead time."""
        return replace(self, transfer=replace(self.transfer, dead_time_s=self.transfer.dead_time_s + late_s))

    def grid(self, dt_s: float) -> FloatArray:
        """(GRID,) rad/s from far below the plant's corner to the Nyquist frequency."""
        return np.geomspace(1e-3 * self.corner, 0.999 * np.pi / dt_s, GRID)

    def step(self, dt_s: float, count: int) -> FloatArray:
        """(count,) the answer to a step at sample 0."""
        from scipy.signal import lfilter

        a, (b,) = sample(self.transfer, dt_s, "zero")
        return np.asarray(lfilter(b, a, np.ones(count)))


def draw_plant(rng: np.random.Generator, kind: str) -> Plant:
    """One of a kind; its corner lies between 0.8 and 20 rad/s."""
    corner = float(np.exp(rng.uniform(np.log(0.8), np.log(20.0))))
    gain = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(-2.0, 2.0)))
    poles = corner * _poles(rng, kind)
    bottom = np.real(np.poly(poles))
    top = np.ones(1)
    if kind == "non-minimum phase":
        top = np.array([-1.0, corner * rng.uniform(1.5, 5.0)])
    dead_s = rng.uniform(0.1, 0.6) / corner if kind in ("dead time", "integrating") else 0.0
    level = bottom[-1] if bottom[-1] else bottom[-2]
    return Plant(kind, Rational(bottom, (top * gain * level / top[-1],), np.array([dead_s])), corner)


def _poles(rng: np.random.Generator, kind: str) -> ComplexArray:
    """In units of the corner."""
    if kind in ("first order", "dead time"):
        return np.array([-1.0 + 0j])
    if kind == "integrating":
        return np.array([0.0, -rng.uniform(1.0, 4.0)], dtype=np.complex128)
    damping = rng.uniform(0.05, 0.2) if kind == "light damping" else rng.uniform(0.35, 0.95)
    pair = -damping + 1j * np.sqrt(1.0 - damping**2)
    extra = {"third order": 1, "fifth order": 3}.get(kind, 0)
    return np.concatenate([[pair, np.conj(pair)], -rng.uniform(1.5, 6.0, extra)])
