"""Other filters on a log's gyro, compared with those it flew with: the content of `flysid filters`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flysid.errors import DataError, FlysidError, UsageError
from flysid.loops.judged import judge
from flysid.reviews.filters import gyro_chain, replayable
from flysid.reviews.gyro import AXES, logged_gyro
from flysid.reviews.logged import LoggedFlight
from flysid.showing import one_of, significant
from flysid.spectra.chain import Chain, Step
from flysid.spectra.replay import Replayed
from flysid.spectra.spectrum import Windows, windows_of
from flysid.spectra.stages import Kind, Stage

OTHERWISE_HZ = 30.0
"""Where vehicles of some kilograms cross over, for a log that does not determine it."""


def stage_of(words: str) -> Stage:
    """A filter as a person writes it: "notch 86 40" (centre and width), "pt1 100", "biquad 90".

    Raises UsageError: it is no filter that is known.

    >>> stage_of("notch 86 40").words
    'notch 86 Hz, Q 2.1'
    """
    name, *numbers = words.lower().split() or [""]
    kinds = [str(kind) for kind in Kind]
    if name not in kinds:
        raise UsageError(f"no filter {name!r}", hint=one_of(kinds, name))
    wanted = 2 if name == Kind.NOTCH else 1
    try:
        values = [float(text) for text in numbers]
    except ValueError:
        values = []
    if len(values) != wanted or not all(np.isfinite(v) and v > 0.0 for v in values):
        form = "'notch HZ WIDTH'" if wanted == 2 else f"'{name} HZ'"
        raise UsageError(f"{words!r} is no filter", hint=f"it is written {form}, frequencies in Hz")
    if wanted == 1:
        return Stage(Kind(name), values[0])
    return Stage(Kind.NOTCH, values[0], q=values[0] / values[1])


def crossover_of(flight: LoggedFlight) -> tuple[float, str]:
    """Of the roll loop in Hz, where the log determines it; and how that is known."""
    unknown = f"not determined; {OTHERWISE_HZ:g} Hz are assumed (--crossover HZ)"
    try:
        (judged,) = judge([flight.log], ("roll",))[:1]
    except (FlysidError, ValueError):
        return OTHERWISE_HZ, unknown
    figure = judged.margins.crossover_hz if judged.margins is not None else None
    if figure is None or figure.value is None:
        return OTHERWISE_HZ, unknown
    edges = f"[{significant(figure.low)}, {significant(figure.high)}]"
    return figure.value, f"{significant(figure.value)} Hz {edges} of the roll loop, from the gains in the log"


@dataclass(frozen=True)
class Cost:
    """What a chain does.

    `delay_s`: of a tone of `at_hz`.
    `phase_deg`: at the crossover.
    `noise`: RMS behind it, deg/s; None where the log cannot show it.
    """

    delay_s: float
    phase_deg: float
    noise: float | None

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"delay_ms": 1000.0 * self.delay_s, "phase_deg": self.phase_deg, "noise_rms": self.noise}


@dataclass(frozen=True, eq=False)
class FilterTrial:
    """A chain as flown, and as tried.

    `present`, `tried`: chains; the same where nothing is tried.
    `crossover_hz`, `crossover_from`: where phase counts, and how that is known.
    `delay_hz`, `noise_hz`: at which the delay is stated, and from which on what the gyro shows is noise.
    `noise_of`: where the noise comes from.
    `costs`: of present and tried.
    `replayed`: axis -> how well the present chain gives what was logged; {} where it cannot.
    `not_replayed`, `remedy`: why not, and what helps.
    """

    present: Chain
    tried: Chain
    crossover_hz: float
    crossover_from: str
    delay_hz: float
    noise_hz: float
    noise_of: str
    costs: tuple[Cost, Cost]
    replayed: dict[str, Replayed]
    not_replayed: str = ""
    remedy: str = ""

    @property
    def changes(self) -> bool:
        """Whether something is tried."""
        return self.tried is not self.present

    @property
    def is_whole(self) -> bool:
        """Whether all filters that were on are known."""
        return not self.present.unknown

    def rows(self) -> list[tuple[str, ...]]:
        """Table for people: filters, then figures, present and tried side by side."""
        words = list(dict.fromkeys(step.words for step in (*self.present.steps, *self.tried.steps)))
        held = [{step.words for step in chain.steps} for chain in (self.present, self.tried)]
        rows = [(f"  {w}", *("on" if w in chain else "-" for chain in held)) for w in words]
        at_least = "" if self.is_whole else "at least "
        rows.append(
            (
                f"delay at {self.delay_hz:g} Hz",
                *(f"{at_least}{1000.0 * c.delay_s:.2f} ms" for c in self.costs),
            )
        )
        at = significant(self.crossover_hz)
        rows.append((f"phase at {at} Hz", *(f"{c.phase_deg:.1f} deg" for c in self.costs)))
        if all(c.noise is not None for c in self.costs):
            rows.append(
                (
                    f"noise above {self.noise_hz:g} Hz",
                    *(f"{significant(c.noise or 0.0)} deg/s" for c in self.costs),
                )
            )
        head = ("FILTERS", "PRESENT", "TRIED")
        return [row if self.changes else row[:2] for row in (head, *rows)]

    def notes(self) -> list[str]:
        """Sentences below the table."""
        found = [f"not among them: {why}" for why in self.present.unknown]
        found += [f"set, but did not run: {why}" for why in self.present.idle]
        found.append(f"crossover: {self.crossover_from}")
        found += [f"noise: {self.noise_of}"] if self.noise_of else []
        if self.replayed:
            shares = ", ".join(
                f"{axis} {100.0 * r.share:.1f} % ({100.0 * r.floor / r.removed:.1f} by rounding)"
                for axis, r in self.replayed.items()
                if r.removed > 0.0
            )
            found.append(f"run again, it misses of what it removed: {shares}")
        elif self.is_whole:
            found.append(f"it cannot be run again: {self.not_replayed}")
        else:
            found.append(f"no noise is stated, for the chain is not whole; try: {self.remedy}")
        return found

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        present, tried = (
            [{"filter": s.stage.words, "stated": s.words, "rate_hz": s.rate_hz} for s in chain.steps]
            for chain in (self.present, self.tried)
        )
        return {
            "present": {"filters": present, **self.costs[0].to_dict()},
            "tried": {"filters": tried, **self.costs[1].to_dict()} if self.changes else None,
            "unknown": list(self.present.unknown),
            "crossover_hz": self.crossover_hz,
            "crossover_from": self.crossover_from,
            "delay_hz": self.delay_hz,
            "noise_from_hz": self.noise_hz,
            "noise_of": self.noise_of,
            "replay": {axis: found.to_dict() for axis, found in self.replayed.items()},
            "not_replayed": self.not_replayed,
        }


def try_filters(
    flight: LoggedFlight,
    more: Sequence[str] = (),
    without: Sequence[str] = (),
    *,
    crossover_hz: float = 30.0,
    crossover_from: str = "30 Hz are assumed",
    delay_hz: float = 10.0,
    noise_hz: float = 20.0,
) -> FilterTrial:
    """The filters of a log, and others in their place.

    `more`: filters that are added, see `stage_of`.
    `without`: filters that are taken away, by a part of their words.
    `crossover_hz`, `crossover_from`: where phase counts, and how that is known.
    `delay_hz`: at which the delay is stated.
    `noise_hz`: above it, what the gyro shows is noise.
    Raises DataError: the firmware's filters are not known. Raises UsageError: a filter is no filter, lies
    above half the rate, or is not there.
    """
    stages = [(words, stage_of(words)) for words in more]
    gyro = logged_gyro(flight)
    present = gyro_chain(flight, gyro)
    tried = _tried(present, stages, without)
    windows, behind = _noise(flight, noise_hz)
    costs = tuple(
        Cost(
            chain.delay_s(delay_hz),
            chain.phase_deg(crossover_hz),
            _left(chain, present, windows, behind, noise_hz),
        )
        for chain in (present, tried)
    )
    replayed: dict[str, Replayed] = {}
    why = remedy = ""
    try:
        rows = replayable(flight, gyro)
        replayed = {axis: rows.compare(present, axis) for axis in AXES}
    except DataError as error:
        why, remedy = error.advice, error.hint
    noise_of = ""
    if windows is not None and not present.unknown:
        of = "behind its filters, their effect taken back" if behind else "before its filters"
        noise_of = f"of the gyro {of}, up to {significant(windows.nyquist_hz)} Hz"
    return FilterTrial(
        present,
        tried,
        crossover_hz,
        crossover_from,
        delay_hz,
        noise_hz,
        noise_of,
        (costs[0], costs[1]),
        replayed,
        why,
        remedy,
    )


def _tried(present: Chain, more: Sequence[tuple[str, Stage]], without: Sequence[str]) -> Chain:
    for part in without:
        if not any(part in step.words for step in present.steps):
            names = [step.words for step in present.steps]
            raise UsageError(f"no filter {part!r} is on", hint=one_of(names, part) if names else "none is")
    if not more and not without:
        return present
    kept = tuple(s for s in present.steps if not any(part in s.words for part in without))
    rate = (kept or present.steps)[-1].rate_hz if present.steps else 0.0
    if not rate:
        raise UsageError("no filter is on: at which rate another one would run is not known")
    for words, stage in more:
        if float(np.max(stage.hz)) >= rate / 2.0:
            raise UsageError(f"{words!r} lies above half of {significant(rate)} Hz, at which it would run")
    return Chain(kept, present.unknown).with_steps([Step(stage, rate, words) for words, stage in more])


def _noise(flight: LoggedFlight, noise_hz: float) -> tuple[Windows | None, bool]:
    """The spectrum of the axis that shows most noise; and whether it is of the gyro behind its filters."""
    gyro = logged_gyro(flight)
    found = []
    for column in gyro.best.values():
        air = column.where(flight.flying(column.time_s))
        try:
            found.append(windows_of(air.time_s, air.values))
        except DataError:
            continue
    if not found:
        return None, False
    return max(found, key=lambda windows: windows.rms(noise_hz)), gyro.best is not gyro.raw


def _left(
    chain: Chain, present: Chain, windows: Windows | None, behind: bool, noise_hz: float
) -> float | None:
    """RMS of the noise behind a chain; what the present filters did to a filtered gyro is taken back."""
    if windows is None or windows.nyquist_hz <= 1.25 * noise_hz or present.unknown:
        return None
    inside = windows.hz >= noise_hz
    hz, density = windows.hz[inside], windows.mean[inside]
    if behind:
        density = density / np.maximum(np.abs(present.response(hz)) ** 2, 1e-4)
    return chain.noise_left(hz, density)
