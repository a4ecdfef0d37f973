"""Causes of spectral peaks: a tone that moves with a motor, with the throttle, or stays in place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.spectra.peaks import Peak, floor_of, fold
from flysid.spectra.settings import Moving
from flysid.spectra.spectrum import Windows


@dataclass(frozen=True, eq=False)
class Source:
    """Something that turns or shakes at a known frequency.

    `name`: "motor 2", "the onboard FFT's strongest peak".
    `hz`: over time.
    `harmonics`: its multiples that are looked for.
    """

    name: str
    hz: Moving
    harmonics: tuple[int, ...] = (1, 2, 3)


@dataclass(frozen=True)
class Match:
    """How well a source explains a peak.

    `source`, `harmonic`: which one.
    `folded`: its frequency lies above half the rate, and shows at another one.
    `true_hz`: that frequency, its median.
    `near`: share of the time that it lies within the peak.
    `follows`: by how much (dB) the signal is stronger at the source's frequency of its own second than at
        those of other seconds; 0 where that is not beyond chance.
    """

    source: Source
    harmonic: int
    folded: bool
    true_hz: float
    near: float
    follows: float

    def words_with(self, names: Sequence[str]) -> str:
        """ "motor 2, 2nd harmonic, folded"; "one of motor 1, motor 4": where several explain it as well."""
        harmonic = {1: "", 2: ", 2nd harmonic", 3: ", 3rd harmonic"}.get(
            self.harmonic, f", {self.harmonic}th harmonic"
        )
        sure = "" if self.follows > 0.0 else " (by its frequency alone)"
        name = self.source.name if len(names) == 1 else f"one of {', '.join(names)}"
        return f"{name}{harmonic}{', folded' if self.folded else ''}{sure}"


def name_causes(
    windows: Windows, peaks: Sequence[Peak], sources: Sequence[Source], throttle: Moving | None = None
) -> list[Peak]:
    """Peaks with their causes, where the log shows one."""
    found = []
    for peak in peaks:
        cause, true_hz = _cause(windows, peak, sources, throttle)
        found.append(replace(peak, cause=cause, true_hz=true_hz))
    return found


def _cause(
    windows: Windows, peak: Peak, sources: Sequence[Source], throttle: Moving | None
) -> tuple[str, float | None]:
    """Words, and the true frequency of what is folded."""
    found = [match for source in sources for match in _matches(windows, peak, source)]
    if found:
        best = max(found, key=lambda match: (match.follows, match.near, -match.harmonic))
        least = _ALIKE * best.follows
        alike = [m.source.name for m in found if m.harmonic == best.harmonic and m.follows >= least]
        return best.words_with(alike), best.true_hz if best.folded else None
    moves = power_of(windows, peak, throttle.held(windows.at_s)) if throttle is not None else None
    if moves is None:
        return "", None
    low, high = moves
    if low > _LEAST_POWER:
        return MOVES, None
    return STAYS if -_LEAST_POWER < low <= 0.0 <= high < _LEAST_POWER else "", None


_ALIKE = 0.7
"""Of the decibels by which the best source explains a peak: others with as many may be the cause, too."""
MOVES = "moves with the throttle: motors or propellers"
STAYS = "stays while the throttle moves: the frame, or what turns steadily"
_LEAST_POWER = 0.25
"""Half of what a propeller's turns grow with: its thrust grows with their square."""


def _matches(windows: Windows, peak: Peak, source: Source, *, most_time: float = 0.5) -> list[Match]:
    """Harmonics of a source that lie within a peak for most of the time."""
    turns = source.hz.held(windows.at_s)
    known = np.isfinite(turns) & (turns > 0.0)
    if known.sum() < 8:
        return []
    low, high = peak.band[0] - windows.step_hz, peak.band[1] + windows.step_hz
    found = []
    for harmonic in source.harmonics:
        true_hz = harmonic * turns[known]
        shown = fold(true_hz, windows.rate_hz)
        near = float(np.mean((shown >= low) & (shown <= high)))
        if near >= most_time:
            middle = float(np.median(true_hz))
            gain = follows(windows.where(known), shown)
            found.append(Match(source, harmonic, middle > windows.nyquist_hz, middle, near, gain))
    return found


def follows(windows: Windows, shown_hz: FloatArray, *, draws: int = 40) -> float:
    """By how much (dB) the signal is stronger at a frequency of its own second than at that of other seconds.

    0 where one of `draws` records that were shifted in time does as well: the frequency hardly moves, or the
    signal does not follow it.

    `shown_hz`: (W,) during each window.
    """
    over = 10.0 * np.log10(np.maximum(windows.density, 1e-300) / floor_of(windows.mean))
    place = np.clip(np.rint(shown_hz / windows.step_hz).astype(np.int64) - 1, 0, len(windows.hz) - 1)
    rows = np.arange(len(place))
    own = float(over[rows, place].mean())
    least = max(1, len(place) // 10)
    shifts = np.unique(np.linspace(least, len(place) - least, draws).astype(np.int64))
    others = np.array([over[rows, np.roll(place, shift)].mean() for shift in shifts])
    return own - float(np.median(others)) if own > others.max() else 0.0


def sizes_along(windows: Windows, turns_hz: FloatArray, *, reach: int = 1, fewest: int = 8) -> FloatArray:
    """(M,) RMS of what shakes at each of several frequencies that move; NaN where they are rarely apart.

    It is what stands above the floor within so many steps. A window counts for a frequency where no other
    one is as near as that.

    `turns_hz`: (M, W) during each window; NaN or zero where they are not known.
    `fewest`: windows that a size rests on.
    """
    known = np.isfinite(turns_hz) & (turns_hz > 0.0)
    place = (
        np.rint(fold(np.where(known, turns_hz, 0.0), windows.rate_hz) / windows.step_hz).astype(np.int64) - 1
    )
    floor = floor_of(windows.mean)
    found = np.full(len(turns_hz), np.nan)
    for number in range(len(turns_hz)):
        others = np.delete(place, number, axis=0)
        clear = known[number] & (np.abs(others - place[number]) > 2 * reach).all(axis=0)
        clear &= (place[number] >= reach) & (place[number] < len(windows.hz) - reach)
        if clear.sum() >= fewest:
            near = place[number][clear][:, None] + np.arange(-reach, reach + 1)
            excess = np.take_along_axis(windows.density[clear], near, axis=1) - floor[near]
            power = float(excess.sum(axis=1).mean()) * windows.step_hz
            found[number] = np.sqrt(max(0.0, power))
    return found


def power_of(windows: Windows, peak: Peak, throttle: FloatArray) -> tuple[float, float] | None:
    """95 % interval of the power of the throttle with which a peak's frequency grows; None where unknown.

    A propeller's is 0.5 to 1; that of a frame is 0. A peak that hides in the noise shows neither, and so does
    a throttle that hardly moves.
    """
    low, high = min(0.7 * peak.hz, peak.band[0]), max(1.3 * peak.hz, peak.band[1])
    band = np.flatnonzero((windows.hz >= low) & (windows.hz <= high))
    if len(band) < 5:
        return None
    floor = floor_of(windows.mean)[band]
    over = windows.density[:, band] / floor
    clear = np.isfinite(throttle) & (throttle > 0.02) & (over.max(axis=1) > 10.0)
    if clear.sum() < 20 or np.std(np.log(throttle[clear])) < 0.05:
        return None
    x = np.log(throttle[clear])
    y = np.log(windows.hz[band][over[clear].argmax(axis=1)])
    x, y = x - x.mean(), y - y.mean()
    power = float(x @ y / (x @ x))
    rest = y - power * x
    error = float(np.sqrt(2.0 * (rest @ rest) / (len(x) - 2) / (x @ x)))  # windows overlap by half
    return (power - 1.96 * error, power + 1.96 * error) if 1.96 * error < _LEAST_POWER else None
