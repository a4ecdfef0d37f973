"""Section "Vibration and filters": how much a vehicle shakes, at which frequencies, what its filters cost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from flysid.reviews.fact import OSCILLATION, Action, Fact, Finding, Grade, Section
from flysid.reviews.figures import absent, fact_of, limit
from flysid.reviews.gyro import motors_hz
from flysid.reviews.gyro_spectra import Shaking
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.notches import propose_notch
from flysid.reviews.shaking import accelerometer_clips, accelerometer_level
from flysid.reviews.spectrum_pictures import pictures_of
from flysid.showing import first_of, list_words, significant
from flysid.spectra.peaks import Peak

MOTION_HZ = 20.0
"""Below it, what moves is the vehicle."""
BANDS_HZ = {"mid": (MOTION_HZ, 80.0), "high": (80.0, np.inf)}
"""Key of a band -> its edges: propellers' wash and the frame; motors."""
DELAY_HZ = 10.0
PHASE_HZ = 30.0
"""At which a chain of filters is described: where vehicles are steered, and where small ones cross over."""
TONE_SHARE = 0.25
"""Of the power of all that the gyro measures: from there on, a tone is worth a sentence."""


def review(flight: LoggedFlight) -> Section:
    """Section "Vibration and filters"."""
    shaking = Shaking.of(flight)
    facts = (
        *accelerometer_level(flight),
        *accelerometer_clips(flight),
        *_gyro_facts(shaking),
        *_filter_facts(shaking),
    )
    findings = tuple(_findings(shaking, facts)) if flight.was_flown else ()
    actions = tuple(_actions(shaking)) if flight.was_flown else ()
    shown = pictures_of(shaking.windows, shaking.peaks, shaking.throttle)
    return Section("vibration", "Vibration and filters", facts, findings, actions, shown)


def _gyro_facts(shaking: Shaking) -> Iterator[Fact]:
    gyro = shaking.gyro
    if not shaking.windows:
        why = "the log holds no gyro" if not gyro.best else "the gyro was logged too little in the air"
        yield absent("vibration.gyro_rate", why, gyro.remedy)
        return
    addresses = tuple(column.address for column in gyro.best.values())
    rate = max(windows.rate_hz for windows in shaking.windows.values())
    before = "before the filters" if gyro.best is gyro.raw else "behind the filters"
    folds = f"frequencies above {significant(rate / 2.0)} Hz show below it"
    note = "; ".join(filter(None, (before, folds, gyro.note)))
    yield replace(fact_of("vibration.gyro_rate", rate, addresses, note=note), remedy=gyro.remedy)
    yield from (_band(shaking, key, addresses) for key in BANDS_HZ)
    yield from _peak_facts(shaking, addresses)
    yield from _motor_facts(shaking)


def _band(shaking: Shaking, band: str, addresses: tuple[str, ...]) -> Fact:
    low, high = BANDS_HZ[band]
    words = f"{low:g} to {high:g} Hz" if np.isfinite(high) else f"above {low:g} Hz"
    key = "vibration.gyro_{band}"
    found = {axis: w.rms(low, high) for axis, w in shaking.windows.items() if w.nyquist_hz > 1.25 * low}
    if not found:
        remedy = shaking.gyro.remedy
        return absent(key, "the gyro is logged too slowly", remedy, band=band, words=words)
    axis = max(found, key=lambda name: found[name])
    return fact_of(key, found[axis], addresses, note=f"RMS, worst in {axis}", band=band, words=words)


def _peak_facts(shaking: Shaking, addresses: tuple[str, ...]) -> Iterator[Fact]:
    strongest = shaking.strongest
    if strongest is None:
        yield fact_of("vibration.peak", "none above the noise", addresses)
        return
    axis, peak = strongest
    fields = (addresses[list(shaking.windows).index(axis)],)
    notes = [f"{axis}, {peak.height_db:.0f} dB over the floor, Nyquist {significant(peak.nyquist_hz)} Hz"]
    notes += [peak.cause] if peak.cause else []
    notes += [f"its true frequency is {significant(peak.true_hz)} Hz"] if peak.true_hz else []
    notes += [_folded_words(peak)] if shaking.may_fold(peak) and peak.true_hz is None else []
    yield fact_of("vibration.peak", peak.hz, fields, interval=peak.interval, note="; ".join(notes))
    grade = limit("vibration.tone").grade(peak.rms) if _is_loud(shaking, axis, peak) else Grade.PLAIN
    yield fact_of("vibration.peak_rms", peak.rms, fields, grade=grade)


def _folded_words(peak: Peak) -> str:
    others = [f"{hz:.0f}" for hz in peak.folded(4.0 * peak.nyquist_hz)]
    return f"or folded from {first_of(others, 3)} Hz"


def _is_loud(shaking: Shaking, axis: str, peak: Peak) -> bool:
    return peak.rms**2 >= TONE_SHARE * shaking.windows[axis].rms() ** 2


def _filter_facts(shaking: Shaking) -> Iterator[Fact]:
    chain = shaking.chain
    if chain is None or not (chain.steps or chain.unknown):
        yield absent("vibration.filter_delay", shaking.no_chain or "no filter is on", at="")
        return
    note = "; ".join(dict.fromkeys(step.words for step in chain.steps))
    if chain.unknown:
        note = f"without: {'; '.join(chain.unknown)}" + (f". {note}" if note else "")
    delay_ms, phase_deg = 1000.0 * chain.delay_s(DELAY_HZ), chain.phase_deg(PHASE_HZ)
    yield fact_of("vibration.filter_delay", delay_ms, note=note, at=f" at {DELAY_HZ:g} Hz")
    yield fact_of("vibration.filter_phase", phase_deg, note=note, at=f" at {PHASE_HZ:g} Hz")
    if shaking.is_raw and not chain.unknown:
        axis = max(shaking.windows, key=lambda name: shaking.windows[name].rms(MOTION_HZ))
        windows = shaking.windows[axis]
        noise = windows.hz >= MOTION_HZ
        left = chain.noise_left(windows.hz[noise], windows.mean[noise])
        note = f"RMS above {MOTION_HZ:g} Hz in {axis}; {significant(windows.rms(MOTION_HZ))} before them"
        yield fact_of("vibration.filter_noise", left, (shaking.gyro.raw[axis].address,), note=note)


def _findings(shaking: Shaking, facts: tuple[Fact, ...]) -> Iterator[Finding]:
    of = {fact.key: fact for fact in facts}
    tone = list(_motor_finding(shaking)) or list(_tone_finding(shaking, of))
    yield from tone
    level = of.get("vibration.accel_level")
    if tone and level is not None and level.grade is Grade.GOOD:
        level = None  # it does not show slow oscillation, and would sound like praise
    if level is not None and isinstance(level.value, float) and level.grade is not Grade.PLAIN:
        yield _level_finding(level, of["vibration.accel_peak"])
    clips = of.get("vibration.accel_clips")
    if clips is not None and isinstance(clips.value, float) and clips.value > 0.0:
        times = "once" if clips.value == 1.0 else f"{clips.value:.0f} times"
        yield Finding(f"The accelerometer clipped {times}", clips.grade, 0.6, clips.key, clips.note)


def _level_finding(level: Fact, peak: Fact) -> Finding:
    """How high the vibration stands; a peak beyond the limit counts where its middle does not."""
    middle, top = (significant(float(fact.value or 0.0)) for fact in (level, peak))
    if level.grade is Grade.GOOD and peak.grade.rank >= Grade.WATCH.rank:
        words = f"Vibration is acceptable, with peaks beyond the limit: {middle} m/s2, up to {top}"
        return Finding(words, Grade.WATCH, 0.7, level.key, level.note)
    size = {Grade.GOOD: "low", Grade.WATCH: "high", Grade.BAD: "too high"}[level.grade]
    words = f"Vibration is {size}: {middle} m/s2, up to {top}"
    return Finding(words, level.grade, 0.2 if level.grade is Grade.GOOD else 0.7, level.key, level.note)


def _tone_finding(shaking: Shaking, of: dict[str, Fact]) -> Iterator[Finding]:
    strongest = shaking.strongest
    if strongest is None or "vibration.peak_rms" not in of:
        return
    grade = of["vibration.peak_rms"].grade
    if grade.rank < Grade.WATCH.rank:
        return
    axis, peak = strongest
    if shaking.commanded(axis, peak):
        return
    axes = [name for name in shaking.peaks if name == axis or _shares(shaking, name, peak)]
    verb = "shakes" if len(axes) == 1 else "shake"
    text = f"{list_words(axes).capitalize()} {verb} by {significant(peak.rms)} deg/s"
    rate, at = significant(2.0 * peak.nyquist_hz), significant(peak.hz)
    if peak.cause or not shaking.may_fold(peak):
        more = f"{peak.cause}; logged at {rate} Hz" if peak.cause else ""
        if peak.true_hz is not None:
            at, more = significant(peak.true_hz), f"{more}, where it shows at {at} Hz"
        yield Finding(f"{text} at {at} Hz", grade, 0.8, "vibration.peak", more, OSCILLATION)
        return
    more = f"it shows at {at} Hz, {_folded_words(peak)}"
    words = f"{text}; a log of {rate} Hz does not show how fast"
    yield Finding(words, grade, 0.8, "vibration.peak", more, OSCILLATION)


def _motor_facts(shaking: Shaking) -> Iterator[Fact]:
    if not shaking.windows or len(motors_hz(shaking.flight)) < 2:
        return
    worst = shaking.worst_motor
    if worst is None:
        yield fact_of("vibration.worst_motor", "none stands out")
        return
    number, axis, size = worst
    note = f"{significant(size)} deg/s in {axis} at its own frequency, twice as much as any other at least"
    grade = limit("vibration.tone").grade(size)
    yield fact_of("vibration.worst_motor", f"motor {number}", note=note, grade=grade)


def _motor_finding(shaking: Shaking) -> Iterator[Finding]:
    worst = shaking.worst_motor
    if worst is None:
        return
    number, axis, size = worst
    grade = limit("vibration.tone").grade(size)
    if grade.rank >= Grade.WATCH.rank:
        text = f"Motor {number} shakes {axis} by {significant(size)} deg/s"
        more = "at its own frequency: a propeller, a shaft or a bearing"
        yield Finding(text, grade, 0.9, "vibration.worst_motor", more)


def _shares(shaking: Shaking, axis: str, peak: Peak) -> bool:
    """Whether an axis shakes at the frequency of another one's peak."""
    return any(
        peak.band[0] <= own.hz <= peak.band[1] and _is_loud(shaking, axis, own) for own in shaking.peaks[axis]
    )


def _actions(shaking: Shaking) -> Iterator[Action]:
    worst = shaking.worst_motor
    if worst is not None and limit("vibration.tone").grade(worst[2]).rank >= Grade.WATCH.rank:
        number, axis, size = worst
        yield Action(
            f"Check motor {number}: propeller, shaft, bearings",
            f"{axis} shakes by {significant(size)} deg/s at its frequency, twice as much as at any other's",
            weight=0.8,
            fact="vibration.worst_motor",
        )
    strongest = shaking.strongest
    if strongest is None or shaking.chain is None or not shaking.is_raw:
        return
    axis, peak = strongest
    action = propose_notch(shaking.flight, shaking.chain, shaking.windows[axis], peak, MOTION_HZ, PHASE_HZ)
    if action is not None:
        yield action
