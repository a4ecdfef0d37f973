"""What gains make of a set of plants: stability, margins, speed, noise; many gains and plants at once.

All from frequency responses, so that a plant may be a fitted model, a rule, or the end of an interval. Ms is
the largest |1 / (1 + L)| of the loop cut at the plant's input; stability is read off the turning of 1 + L
(Nyquist): plants are stable, controller and position integrate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.integrate import trapezoid

from flysid.dataset import FloatArray
from flysid.design.law import ComplexArray, Gains, LoopParts


@dataclass(frozen=True, eq=False)
class Laws:
    """Several sets of gains of one kind of controller: (S, 5) numbers of `TUNED`, and what they share."""

    tuned: FloatArray
    error_hz: float = 0.0
    on_error: bool = False

    @classmethod
    def of(cls, gains: Gains, tuned: FloatArray | None = None) -> Laws:
        """The kind of controller that `gains` belong to, with their numbers or others."""
        numbers = gains.tuned()[None] if tuned is None else tuned
        return cls(numbers, gains.error_hz, bool(gains.on_error))


@dataclass(frozen=True, eq=False)
class Figures:
    """(S, P) arrays: gains by plants.

    `stable`: whether the loop is.
    `ms`: largest amplification of disturbances.
    `peak`: largest gain from the reference to the position.
    `noise`: largest gain from noise of the velocity to the input.
    `crossover`: rad/s, where the loop's gain falls through one for the last time; 0 where it never is one.
    `tracking`: integral of the squared error after a step of 1 m, m^2 s.
    `disturbance`: the same after a step of 1 at the plant's input.
    `loop`: (S, P, F) cut at the plant's input.
    """

    stable: npt.NDArray[np.bool_]
    ms: FloatArray
    peak: FloatArray
    noise: FloatArray
    crossover: FloatArray
    tracking: FloatArray
    disturbance: FloatArray
    loop: ComplexArray


def figures(laws: Laws, plants: ComplexArray, parts: LoopParts) -> Figures:
    """Of every law on every plant (P, F)."""
    position, velocity, integral, derivative = (laws.tuned[:, k, None, None] for k in range(4))
    through = parts.filtered(laws.error_hz)
    slope = derivative * parts.slope(laws.tuned[:, 4])[:, None]
    centre = (velocity + integral * parts.total) * through
    if laws.on_error:
        centre = centre + slope * through
        slope = np.zeros_like(slope)
    seen = centre + slope
    asked = centre * position
    return figures_of_paths(seen + asked * parts.place, asked, seen, plants, parts, integral[:, :, 0])


def figures_of_paths(
    centre: ComplexArray,
    asked: ComplexArray,
    seen: ComplexArray,
    plants: ComplexArray,
    parts: LoopParts,
    integral: FloatArray | None = None,
) -> Figures:
    """Of controllers (S, 1, F) by their paths to the input, on every plant (P, F).

    `centre`, `asked`, `seen`: from the velocity and the position that it comes to; from the reference; from
        the measured velocity alone.
    `integral`: (S, 1) more than 0 where the controller integrates; None: all do.
    """
    loop = centre * plants
    whole = 1.0 + loop
    answer = asked * plants * parts.place / whole
    lag = (1.0 - answer) / parts.omega
    push = plants * parts.place / whole / parts.omega
    sensitivity = 1.0 / np.abs(whole)
    return Figures(
        _is_stable(whole, loop, np.ones(1) if integral is None else integral),
        sensitivity.max(axis=-1),
        np.abs(answer).max(axis=-1),
        (np.abs(seen) * sensitivity).max(axis=-1),
        _crossover(np.abs(loop), parts.omega),
        _square(lag, parts.omega),
        _square(push, parts.omega),
        loop,
    )


def _square(values: ComplexArray, omega: FloatArray) -> FloatArray:
    """Integral of the squared signal by Parseval's theorem, over ln omega."""
    return np.asarray(trapezoid(np.abs(values) ** 2 * omega, np.log(omega), axis=-1) / np.pi)


def _is_stable(whole: ComplexArray, loop: ComplexArray, integral: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether 1 + L comes home to the positive real axis, turning from where its integrators start it."""
    start = np.where(integral > 0.0, -np.pi, -0.5 * np.pi)
    first = np.angle(loop[..., 0])
    first = first + 2.0 * np.pi * np.round((start - first) / (2.0 * np.pi))
    own = np.angle(whole)
    first = own[..., 0] + 2.0 * np.pi * np.round((first - own[..., 0]) / (2.0 * np.pi))
    turned = np.unwrap(own, axis=-1)
    return np.asarray(np.abs(first + turned[..., -1] - turned[..., 0]) < 0.5 * np.pi)


def _crossover(size: FloatArray, omega: FloatArray) -> FloatArray:
    above = size > 1.0
    last = size.shape[-1] - 1 - np.argmax(above[..., ::-1], axis=-1)
    return np.asarray(np.where(above.any(axis=-1), omega[last], 0.0))
