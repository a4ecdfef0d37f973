"""The gyro's filters of Betaflight, from the settings in a blackbox header.

Since 4.2 the second low-pass filter runs with every sample of the gyro, and all others with every PID loop.
Before, all ran with every sample. EmuFlight states other settings, and is refused; INAV is apart.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.ingest.lake.headers import WHOLE, needed_numbers, stated_number, stated_numbers
from flysid.spectra.chain import AtTimes, Chain, Step
from flysid.spectra.settings import Moving, thinned
from flysid.spectra.stages import Kind, Stage

KINDS = (Kind.PT1, Kind.BIQUAD, Kind.PT2, Kind.PT3)
"""By the number of `gyro_lpf1_type`."""
DYNAMIC_NOTCH = 1 << 29
"""Bit of `features` for dynamic notches, from 3.2 to 4.2; since 4.3 `dyn_notch_count` alone switches them."""
SLOWEST_DYNAMIC_HZ = 2000.0
"""Of the loop, since 4.3: dynamic notches do not run in a slower one."""
EXPO = 5.0
"""Of the dynamic low-pass, where a header since 4.3 does not state `gyro_lpf1_dyn_expo`."""
THROTTLE_STEPS = 100
WAIT_S = 0.005
"""The throttle moves the dynamic low-pass filter in so many steps, and not again before this time."""
MOST_HARMONICS = 3
"""RPM_FILTER_HARMONICS_MAX."""
NYQUIST_SHARE = 0.48
"""Of the rate: no RPM notch goes higher."""


def betaflight_chain(
    settings: Mapping[str, str],
    slower: float,
    throttle: Moving | None = None,
    motors_hz: Sequence[Moving] = (),
) -> Chain:
    """The gyro's filters as a header states them.

    `settings`: of the header, by name.
    `slower`: real time of an iteration over the nominal one.
    `throttle`: 0 to 1.
    `motors_hz`: turns a second of each motor, where the log holds them.
    Raises DataError: the header is of another firmware, or of a version that states no filters.
    """
    version = _version(settings)
    sample_s = 1e-6 * _positive(settings, "looptime") * slower
    every = (
        _positive({"pid_process_denom": "1", **settings}, "pid_process_denom") if version >= (4, 2) else 1.0
    )
    loop_s = sample_s * every
    loop_hz, sample_hz = 1.0 / loop_s, 1.0 / sample_s
    steps: list[Step] = []
    unknown = _not_stated(settings, version)
    second = _second_low_pass(settings, version, slower)
    if second is not None and version >= (4, 2):
        steps.append(Step(second[0], sample_hz, second[1]))
    rpm, why = _rpm_notches(settings, loop_hz, motors_hz)
    steps += rpm
    unknown += why
    steps += _notches(settings, loop_hz, slower)
    if second is not None and version < (4, 2):
        steps.append(Step(second[0], sample_hz, second[1]))
    first, why = _first_low_pass(settings, version, loop_hz, slower, throttle)
    steps += first
    unknown += why
    unknown += _dynamic_notches(settings, version, loop_hz * slower)
    return Chain(tuple(steps), tuple(unknown), _idle_notches(settings))


def _version(settings: Mapping[str, str]) -> tuple[int, int]:
    revision = settings.get("Firmware revision", "")
    found = re.match(r"Betaflight (\d+)\.(\d+)", revision)
    if not found or (version := (int(found[1]), int(found[2]))) < (3, 1):
        raise DataError(
            f"the filters of {revision or 'an unnamed firmware'} are not known here",
            hint="those of Betaflight 3.1 and later are; the spectrum itself: flysid spectrum LOG",
        )
    return version


def _positive(settings: Mapping[str, str], *names: str) -> float:
    """A number that others are divided by.

    Raises DataError: the header does not state it, or states 0 or less.
    """
    number = needed_numbers(settings, *names)[0]
    if number <= 0.0:
        raise DataError(f"the log's header states {number:g} for {names[0]}", hint=WHOLE)
    return number


def _kind(settings: Mapping[str, str], *names: str) -> Kind:
    """Of a low-pass, PT1 where none is stated.

    Raises DataError: the version has a kind that is not known here.
    """
    number = int(stated_number(settings, *names, otherwise=0.0))
    if not 0 <= number < len(KINDS):
        raise DataError(
            f"the log's header states {number} for {names[0]}: no such low-pass is known here",
            hint="the spectrum itself: flysid spectrum LOG",
        )
    return KINDS[number]


def _not_stated(settings: Mapping[str, str], version: tuple[int, int]) -> list[str]:
    """Filters that every header of the version states, and this one does not: a line is lost."""
    names = {
        "the first low-pass": (
            "gyro_lpf1_static_hz",
            "gyro_lowpass_hz",
            "gyro_lpf1_dyn_hz",
            "gyro_lowpass_dyn_hz",
        ),
        "the second low-pass": ("gyro_lpf2_static_hz", "gyro_lowpass2_hz"),
        "the fixed notches": ("gyro_notch_hz",),
    }
    if version < (3, 4):
        return []
    return [
        f"{what}: the log's header does not state {lines[0]}"
        for what, lines in names.items()
        if not any(line in settings for line in lines)
    ]


def _second_low_pass(
    settings: Mapping[str, str], version: tuple[int, int], slower: float
) -> tuple[Stage, str] | None:
    """It came with 3.4. Filters are made for the nominal time: in a slower loop their edges lie lower."""
    if version < (3, 4):
        return None
    hz = stated_number(settings, "gyro_lpf2_static_hz", "gyro_lowpass2_hz", otherwise=0.0)
    kind = _kind(settings, "gyro_lpf2_type", "gyro_lowpass2_type")
    return (Stage(kind, hz / slower), f"gyro_lpf2 {kind} {hz:g} Hz") if hz > 0.0 else None


def _notches(settings: Mapping[str, str], rate_hz: float, slower: float) -> list[Step]:
    """Two of a fixed frequency; one above half the rate is moved there, as the firmware does it."""
    found = []
    centres = stated_numbers(settings, "gyro_notch_hz")
    for centre, edge in zip(centres, stated_numbers(settings, "gyro_notch_cutoff"), strict=False):
        nominal_half = rate_hz * slower / 2.0
        hz = min(centre, nominal_half) if edge < nominal_half else 0.0
        if hz > edge > 0.0:
            stage = Stage(Kind.NOTCH, hz / slower, q=hz * edge / (hz * hz - edge * edge))
            found.append(Step(stage, rate_hz, f"gyro_notch {centre:g} Hz, cutoff {edge:g} Hz"))
    return found


def _first_low_pass(
    settings: Mapping[str, str],
    version: tuple[int, int],
    rate_hz: float,
    slower: float,
    throttle: Moving | None,
) -> tuple[list[Step], list[str]]:
    kind = _kind(settings, "gyro_lpf1_type", "gyro_lowpass_type", "gyro_soft_type")
    moves = stated_numbers(settings, "gyro_lpf1_dyn_hz", "gyro_lowpass_dyn_hz")
    if len(moves) == 2 and moves[0] > 0.0:
        low, high = moves
        words = f"gyro_lpf1 {kind} {low:g} to {high:g} Hz with the throttle"
        if throttle is None:
            return [], [f"{words}: the log does not hold the throttle"]
        expo = stated_number(settings, "gyro_lpf1_dyn_expo", otherwise=EXPO) / 10.0

        def at(time_s: FloatArray) -> Stage:
            opened = throttle_in_force(time_s, np.nan_to_num(throttle.held(time_s)))
            return Stage(kind, _edge(opened, low, high, expo, version) / slower)

        return [Step(at(thinned(throttle)), rate_hz, words, at)], []
    hz = stated_number(settings, "gyro_lpf1_static_hz", "gyro_lowpass_hz", otherwise=0.0)
    return ([Step(Stage(kind, hz / slower), rate_hz, f"gyro_lpf1 {kind} {hz:g} Hz")] if hz > 0.0 else []), []


def _edge(opened: FloatArray, low: float, high: float, expo: float, version: tuple[int, int]) -> FloatArray:
    """(N,) Hz at a throttle. Before 4.3, and with an expo of 0, it follows another curve in whole Hz."""
    if version >= (4, 3) and expo > 0.0:
        curve = opened * (1.0 - opened) * expo + opened
        return np.asarray(low + (high - low) * curve)
    curve = opened * (1.0 - opened * opened / 3.0) * 1.5
    hz = np.maximum(curve * high, low)
    return np.asarray(hz if version >= (4, 3) else np.floor(hz))


def throttle_in_force(time_s: FloatArray, throttle: FloatArray) -> FloatArray:
    """(N,) the throttle that the dynamic low-pass filter last followed: in steps, each held for a while."""
    steps = np.rint(throttle * THROTTLE_STEPS)
    begins = np.concatenate([[0], np.flatnonzero(np.diff(steps)) + 1])
    ends = np.concatenate([begins[1:], [len(steps)]])
    places, values = [0], [steps[0]]
    last_s = -np.inf
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        place = max(begin, int(np.searchsorted(time_s, last_s + WAIT_S)))
        if place < end and steps[begin] != values[-1]:
            places.append(place)
            values.append(steps[begin])
            last_s = time_s[place]
    lengths = np.diff([*places, len(steps)])
    return np.repeat(np.asarray(values), lengths) / THROTTLE_STEPS


def _harmonics(settings: Mapping[str, str]) -> int:
    """Of a motor's turns that have an RPM notch."""
    return int(stated_number(settings, "rpm_filter_harmonics", "gyro_rpm_notch_harmonics", otherwise=0.0))


def _hears_motors(settings: Mapping[str, str]) -> bool:
    """Whether the ESCs send their RPM."""
    return bool(int(stated_number(settings, "dshot_bidir", otherwise=0.0)))


def _idle_notches(settings: Mapping[str, str]) -> tuple[str, ...]:
    """RPM notches that are set and never ran; a header without `dshot_bidir` is of a version without them."""
    harmonics = _harmonics(settings)
    if not harmonics or "dshot_bidir" not in settings or _hears_motors(settings):
        return ()
    return (
        f"{harmonics} RPM notches for each motor: dshot_bidir is off, so that the motors' RPM is unknown",
    )


def _rpm_notches(
    settings: Mapping[str, str], rate_hz: float, motors_hz: Sequence[Moving]
) -> tuple[list[Step], list[str]]:
    """A notch for every motor and harmonic; they fade out towards their lowest frequency."""
    harmonics = _harmonics(settings)
    if not harmonics or not _hears_motors(settings):
        return [], []
    if not motors_hz:
        return [], [f"{harmonics} RPM notches for each motor: the log does not hold the motors' RPM"]
    q = _positive(settings, "rpm_filter_q", "gyro_rpm_notch_q") / 100.0
    lowest = _positive(settings, "rpm_filter_min_hz", "gyro_rpm_notch_min")
    fade = stated_number(settings, "rpm_filter_fade_range_hz", otherwise=0.0)
    weights = stated_numbers(settings, "rpm_filter_weights") or (100.0,) * MOST_HARMONICS
    found = []
    for number, motor in enumerate(motors_hz, 1):
        for harmonic, percent in zip(range(1, harmonics + 1), weights, strict=False):
            at = _rpm_notch(motor, harmonic, rate_hz, q, lowest, fade, percent / 100.0)
            words = f"RPM notch of motor {number}, harmonic {harmonic}"
            found.append(Step(at(thinned(motor)), rate_hz, words, at))
    return found, []


def _rpm_notch(
    motor: Moving, harmonic: int, rate_hz: float, q: float, lowest: float, fade: float, weight: float
) -> AtTimes:
    """A notch at a multiple of a motor's turns."""

    def at(time_s: FloatArray) -> Stage:
        turns = harmonic * np.nan_to_num(motor.held(time_s))
        share = np.clip((turns - lowest) / fade, 0.0, 1.0) if fade > 0.0 else 1.0
        hz = np.clip(turns, lowest, NYQUIST_SHARE * rate_hz)
        return Stage(Kind.NOTCH, hz, q=q, weight=weight * share * np.ones(len(hz)))

    return at


def _dynamic_notches(settings: Mapping[str, str], version: tuple[int, int], loop_hz: float) -> list[str]:
    """They follow a spectrum that the firmware computes itself and does not log."""
    if version >= (4, 3):
        on = loop_hz >= SLOWEST_DYNAMIC_HZ and stated_number(settings, "dyn_notch_count", otherwise=0.0) > 0.0
    else:
        switches = int(stated_number(settings, "features", otherwise=0.0))
        on = version >= (3, 2) and bool(switches & DYNAMIC_NOTCH)
    if not on:
        return []
    return ["dynamic notches follow the firmware's own spectrum: the log does not hold their frequencies"]
