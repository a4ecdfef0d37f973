"""Flight plans: what is commanded on the three loops at once. A seed fixes every flight of a plan.

A manoeuvre is a function (time_s, amplitudes, rng) -> (N, 3) of theta_in (deg), phi_in (deg) and vz_in (m/s).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.ingest.synth import manoeuvres

Command = Callable[[FloatArray, tuple[float, float, float], np.random.Generator], FloatArray]

# Of the 12 degrees and 0.7 m/s that the AR.Drone's factory settings allow.
GENTLE = (5.0, 5.0, 0.6)
# Each loop is excited up to about three times its natural frequency: 0.43, 0.09 and 0.72 Hz.
BANDS_HZ = ((0.02, 1.2), (0.02, 0.4), (0.02, 2.0))
PULSE_S = (1.0, 3.0, 0.7)
SWEEP_HZ = (0.3, 0.1, 0.5)


@dataclass(frozen=True)
class Manoeuvre:
    """A named command; `scale` multiplies the gentle amplitudes, loop by loop."""

    name: str
    command: Command
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)


def _same_on_all(signal: Callable[[FloatArray], FloatArray]) -> Command:
    """The paper's own units: one per degree and one per m/s, whatever the amplitudes."""

    def command(time_s: FloatArray, _: tuple[float, ...], __: np.random.Generator) -> FloatArray:
        return np.repeat(signal(time_s)[:, None], 3, axis=1)

    return command


def _multisine(time_s: FloatArray, peaks: tuple[float, ...], rng: np.random.Generator) -> FloatArray:
    return np.column_stack(
        [
            manoeuvres.random_phase_multisine(time_s, band, peak, rng)
            for band, peak in zip(BANDS_HZ, peaks, strict=True)
        ]
    )


def _chirp(time_s: FloatArray, peaks: tuple[float, ...], _: np.random.Generator) -> FloatArray:
    return np.column_stack(
        [manoeuvres.chirp(time_s, band, peak) for band, peak in zip(BANDS_HZ, peaks, strict=True)]
    )


def _pulses(shape: Callable[..., FloatArray], units: int) -> Command:
    """The shape again and again with a rest as long, loop by loop, at random size and sign."""

    def command(time_s: FloatArray, peaks: tuple[float, ...], rng: np.random.Generator) -> FloatArray:
        total = np.zeros((len(time_s), 3))
        for loop, (unit_s, peak) in enumerate(zip(PULSE_S, peaks, strict=True)):
            start_s = float(time_s[0]) + rng.uniform(0.5, 1.5) * unit_s
            while start_s < time_s[-1]:
                size = peak * rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.0)
                total[:, loop] += shape(time_s, start_s, unit_s, size)
                start_s += 2 * units * unit_s
        return total

    return command


def _held(draw: Callable[[FloatArray, float, float, np.random.Generator], FloatArray]) -> Command:
    def command(time_s: FloatArray, peaks: tuple[float, ...], rng: np.random.Generator) -> FloatArray:
        return np.column_stack(
            [draw(time_s, 1.5 * unit_s, peak, rng) for unit_s, peak in zip(PULSE_S, peaks, strict=True)]
        )

    return command


def _pilot(time_s: FloatArray, peaks: tuple[float, ...], rng: np.random.Generator) -> FloatArray:
    return np.column_stack([manoeuvres.pilot(time_s, peak, rng) for peak in peaks])


def _amplitude_sweep(time_s: FloatArray, peaks: tuple[float, ...], _: np.random.Generator) -> FloatArray:
    return np.column_stack(
        [manoeuvres.amplitude_sweep(time_s, hz, p) for hz, p in zip(SWEEP_HZ, peaks, strict=True)]
    )


TRAINING = Manoeuvre("training", _same_on_all(manoeuvres.paper_training))
VALIDATION = Manoeuvre("validation", _same_on_all(manoeuvres.paper_validation))
MULTISINE = Manoeuvre("multisine", _multisine)
CHIRP = Manoeuvre("chirp", _chirp)
DOUBLETS = Manoeuvre("doublets", _pulses(manoeuvres.doublet, 2))
PULSES_3211 = Manoeuvre("3-2-1-1", _pulses(manoeuvres.three_two_one_one, 7))
PRBS = Manoeuvre("prbs", _held(manoeuvres.prbs))
SWEEP = Manoeuvre("amplitude-sweep", _amplitude_sweep)
STEPS = Manoeuvre("steps", _held(manoeuvres.amplitude_steps))
PILOT = Manoeuvre("pilot", _pilot)

# 11.95 degrees and 0.69 m/s: as far as the factory settings allow.
BOLD = (2.39, 2.39, 1.15)
DEMO = tuple(replace(m, scale=BOLD) for m in (STEPS, PILOT, MULTISINE, STEPS, PILOT, MULTISINE))

PLANS: Mapping[str, tuple[Manoeuvre, ...]] = {
    "paper": (TRAINING, VALIDATION),
    "paper-training": (TRAINING,),
    "paper-validation": (VALIDATION,),
    "multisine": (MULTISINE,),
    "chirp": (CHIRP,),
    "doublets": (DOUBLETS,),
    "3-2-1-1": (PULSES_3211,),
    "prbs": (PRBS,),
    "steps": (STEPS,),
    "amplitude-sweep": (SWEEP,),
    "pilot": (PILOT,),
    "demo": DEMO,
    "routine": (MULTISINE, PILOT, MULTISINE, PILOT),
    "mixed": (MULTISINE, DOUBLETS, MULTISINE, STEPS, PULSES_3211, PILOT),
}


def plan_named(name: str) -> tuple[Manoeuvre, ...]:
    """The manoeuvres of a plan; raises UsageError with the nearest name where there is none."""
    try:
        return PLANS[name]
    except KeyError:
        import difflib

        near = difflib.get_close_matches(name, PLANS, n=1)
        hint = near[0] if near else "one of " + ", ".join(PLANS)
        raise UsageError(f"no flight plan {name!r}", hint=hint) from None
