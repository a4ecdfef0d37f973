"""The gyro's filters of ArduPilot (4.0 and later): harmonic notches, then a low-pass filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from functools import partial

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.spectra.chain import AtTimes, Chain, Step
from flysid.spectra.settings import Moving, thinned
from flysid.spectra.stages import Kind, Stage

CUTOFF = "INS_GYRO_FILTER"
HIGHEST_SHARE = 0.48
LOWEST_SHARE = 0.52
"""Of the sampling rate, beyond which no notch goes; of its width, below which none is designed."""


class Mode(IntEnum):
    """What a harmonic notch follows."""

    FIXED = 0
    THROTTLE = 1
    RPM = 2
    ESC = 3
    FFT = 4
    RPM2 = 5


class Option(IntFlag):
    """INS_HNTCH_OPTS, those that change the filter."""

    DOUBLE = 1
    EACH_SOURCE = 2
    TRIPLE = 16
    FIVEFOLD = 64


@dataclass(frozen=True, eq=False)
class Sources:
    """What harmonic notches may follow, where the log holds it.

    `throttle`: 0 to 1.
    `rpm_hz`, `rpm2_hz`, `fft_hz`: turns a second of RPM sensors, and the peak of the onboard FFT.
    `motors_hz`: of each ESC.
    """

    throttle: Moving | None = None
    rpm_hz: Moving | None = None
    rpm2_hz: Moving | None = None
    fft_hz: Moving | None = None
    motors_hz: Sequence[Moving] = ()


def ardupilot_chain(stated: Mapping[str, float], rate_hz: float, sources: Sources = Sources()) -> Chain:
    """The filters between the gyro and the rate controller.

    `stated`: parameters by name.
    `rate_hz`: at which the gyro is sampled and filtered.
    Raises DataError: the log states no INS_GYRO_FILTER.
    """
    if CUTOFF not in stated:
        raise DataError(f"the log does not state {CUTOFF}", hint="log the parameters: they are by default")
    steps: list[Step] = []
    unknown: list[str] = []
    for stem in ("INS_HNTCH", "INS_HNTC2"):
        if stated.get(f"{stem}_ENABLE", 0.0) > 0.0:
            found, why = _harmonic_notches(stated, stem, rate_hz, sources)
            steps += found
            unknown += why
    steps += _plain_notch(stated, rate_hz)
    cut = stated[CUTOFF]
    if 0.0 < cut < rate_hz / 2.0:
        steps.append(Step(Stage(Kind.BIQUAD, cut), rate_hz, f"{CUTOFF} {cut:g}"))
    return Chain(tuple(steps), tuple(unknown))


@dataclass(frozen=True)
class HarmonicNotch:
    """One of them, as designed: what of it stays as it is while its centre moves."""

    q: float
    left: float
    spreads: tuple[float, ...]

    @classmethod
    def of(
        cls, hz: float, width_hz: float, attenuation_db: float, options: Option, rate_hz: float
    ) -> HarmonicNotch:
        """Two or three notches beside each other are that much narrower, and as wide together as one."""
        centre = float(np.clip(hz, LOWEST_SHARE * width_hz, HIGHEST_SHARE * rate_hz))
        spread = width_hz / (32.0 * centre)
        spreads: tuple[float, ...] = (0.0,)
        if options & Option.TRIPLE:
            spreads = (-spread, 0.0, spread)
        elif options & Option.DOUBLE:
            spreads = (-spread, spread)
        each = width_hz / len(spreads)
        edges = (centre / (centre - each / 2.0)) ** 2
        return cls(np.sqrt(edges) / (edges - 1.0), 10.0 ** (-attenuation_db / 20.0), spreads)


def _plain_notch(stated: Mapping[str, float], rate_hz: float) -> list[Step]:
    """INS_NOTCH, of 4.0 and 4.1: one that stays."""
    hz, width = stated.get("INS_NOTCH_FREQ", 0.0), stated.get("INS_NOTCH_BW", 0.0)
    if stated.get("INS_NOTCH_ENABLE", 0.0) <= 0.0 or not width / 2.0 < hz < rate_hz / 2.0:
        return []
    notch = HarmonicNotch.of(hz, width, stated.get("INS_NOTCH_ATT", 15.0), Option(0), rate_hz)
    return [
        Step(Stage(Kind.NOTCH, hz, notch.q, notch.left), rate_hz, f"INS_NOTCH {hz:g} Hz, {width:g} Hz wide")
    ]


def _harmonic_notches(
    stated: Mapping[str, float], stem: str, rate_hz: float, sources: Sources
) -> tuple[list[Step], list[str]]:
    hz = stated.get(f"{stem}_FREQ", 80.0)
    options = Option(int(stated.get(f"{stem}_OPTS", 0.0)))
    if options & Option.FIVEFOLD:
        return [], [f"{stem}: five notches beside each other are not known here"]
    notch = HarmonicNotch.of(
        hz, stated.get(f"{stem}_BW", hz / 2.0), stated.get(f"{stem}_ATT", 40.0), options, rate_hz
    )
    harmonics = [k + 1 for k in range(16) if int(stated.get(f"{stem}_HMNCS", 3.0)) >> k & 1]
    centres, why = _centres(stated, stem, hz, options, sources)
    steps = []
    for centre, moving in centres:
        for harmonic in harmonics:
            for spread in notch.spreads:
                at = _follow(centre, harmonic * (1.0 + spread), notch, rate_hz)
                times = thinned(moving) if moving is not None else np.zeros(1)
                words = f"{stem} {hz:g} Hz, harmonic {harmonic}"
                steps.append(Step(at(times), rate_hz, words, at if moving is not None else None))
    return steps, why


HzAt = Callable[[FloatArray], FloatArray]
Centre = tuple[HzAt, Moving | None]


def _centres(
    stated: Mapping[str, float], stem: str, hz: float, options: Option, sources: Sources
) -> tuple[list[Centre], list[str]]:
    """Functions of time that give the fundamental, and what they follow."""
    mode = int(stated.get(f"{stem}_MODE", 1.0))
    reference = stated.get(f"{stem}_REF", 0.0)
    lowest = hz * stated.get(f"{stem}_FM_RAT", 1.0)
    if mode == Mode.FIXED or reference == 0.0:
        return [(lambda time_s: np.full(len(time_s), hz), None)], []
    follows = {
        Mode.THROTTLE: ("the throttle", [sources.throttle] if sources.throttle is not None else []),
        Mode.RPM: ("an RPM sensor", [sources.rpm_hz] if sources.rpm_hz is not None else []),
        Mode.RPM2: ("an RPM sensor", [sources.rpm2_hz] if sources.rpm2_hz is not None else []),
        Mode.ESC: ("the ESCs' RPM", list(sources.motors_hz)),
        Mode.FFT: ("the onboard FFT", [sources.fft_hz] if sources.fft_hz is not None else []),
    }
    what, found = follows.get(Mode(mode) if mode in set(Mode) else Mode.FIXED, ("what is not known here", []))
    if not found:
        return [], [f"{stem} follows {what}, which the log does not hold"]
    if mode == Mode.THROTTLE:
        (throttle,) = found

        def by_throttle(time_s: FloatArray) -> FloatArray:
            opened = np.maximum(np.nan_to_num(throttle.held(time_s)), 0.0)
            return np.asarray(np.maximum(hz * np.sqrt(opened / reference), lowest))

        return [(by_throttle, throttle)], []

    def by_turns(motors: Sequence[Moving], time_s: FloatArray) -> FloatArray:
        turns = np.mean([np.nan_to_num(motor.held(time_s)) for motor in motors], axis=0)
        return np.asarray(np.maximum(turns * reference, lowest))

    groups = [[one] for one in found] if options & Option.EACH_SOURCE else [found]
    return [(partial(by_turns, group), group[0]) for group in groups], []


def _follow(centre: HzAt, factor: float, notch: HarmonicNotch, rate_hz: float) -> AtTimes:
    def at(time_s: FloatArray) -> Stage:
        hz = factor * centre(time_s)
        on = hz < HIGHEST_SHARE * rate_hz
        return Stage(
            Kind.NOTCH, np.minimum(hz, HIGHEST_SHARE * rate_hz), notch.q, notch.left, on.astype(np.float64)
        )

    return at
