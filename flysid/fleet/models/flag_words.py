"""Sentences for flagged tests: how much the response changed, since when, and how many flights it took."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from scipy import stats
from scipy.optimize import brentq

from flysid.dataset import FloatArray
from flysid.escaping import one_line
from flysid.fleet.models.differences import JudgedChannel, Test, since
from flysid.ingest.align.recipe import Recipe
from flysid.ingest.lake.chosen_flights import shortest_end
from flysid.validate.compare.verdict import ALPHA

NAMELESS = "(no name)"
SEEN = 0.9
"""How often the smallest change that is named would have been found."""


@dataclass(frozen=True)
class Size:
    """A change at one frequency, with its interval, which holds for all frequencies at once.

    `value`, `low`, `high`: percent of gain, or milliseconds of delay.
    `hz`: the frequency at which it stands out most.
    """

    value: float
    low: float
    high: float
    hz: float

    @property
    def is_sure(self) -> bool:
        """Whether the interval leaves zero out."""
        return self.low > 0.0 or self.high < 0.0


@dataclass(frozen=True)
class Flag:
    """A vehicle that differs, in words and numbers."""

    vehicle: str
    channel: str
    question: str
    sentence: str
    p: float
    gain: Size
    delay: Size
    since: str
    since_utc: str


def sizes(test: Test, omega: FloatArray) -> tuple[Size, Size]:
    """The gain (percent) and the delay (ms) of a test, each where it stands out most."""
    k = len(omega)
    reach = float(stats.t.isf(0.5 * ALPHA / (2 * k), test.freedom)) * test.sigmas
    strength = np.abs(test.difference) / test.sigmas
    at = int(np.argmax(strength[:k]))
    late = int(np.argmax(strength[k:]))
    gain = 100.0 * np.expm1(test.difference[at] + reach[at] * np.array([0.0, -1.0, 1.0]))
    delay = -1e3 / omega[late] * (test.difference[k + late] + reach[k + late] * np.array([0.0, 1.0, -1.0]))
    return _size(gain, omega[at]), _size(delay, omega[late])


def _size(value_low_high: FloatArray, omega: float) -> Size:
    value, low, high = value_low_high.tolist()
    return Size(value, low, high, float(omega / 2.0 / np.pi))


def finding(
    test: Test, judged: JudgedChannel, recipe: Recipe, starts: Mapping[str, int | None], name: str
) -> Flag:
    """A flagged test in physical words.

    `starts`: when flights began, UTC in ns.
    `name`: what to call the vehicle.
    """
    gain, delay = sizes(test, judged.band.frequencies)
    first = since(judged, test.vehicle) if test.question == "changed" else ""
    day = date_of(starts.get(first))
    moment = f", since {first}{f' ({day})' if day else ''}" if first else ""
    other = "before" if test.question == "changed" else "the fleet's"
    cause = _signal(recipe, judged.sampling.inputs[0])
    effect = _signal(recipe, judged.sampling.outputs[0])
    sentence = f"{name}: the same {cause} gives {_compare(gain, delay, effect, other)}{moment}"
    return Flag(name, test.channel, test.question, one_line(sentence), test.p, gain, delay,
                   first, day)  # fmt: skip


def _compare(gain: Size, delay: Size, effect: str, other: str) -> str:
    """The sure parts, or that no single number is sure."""
    if not (gain.is_sure or delay.is_sure):
        return f"another {effect} than {other}, though neither gain nor delay alone shows how"
    parts = []
    if gain.is_sure:
        word = "less" if gain.value < 0.0 else "more"
        parts.append(
            f"{abs(gain.value):.0f} % {word} {effect} than {other} at {gain.hz:.2g} Hz ({_range(gain, '%')})"
        )
    if delay.is_sure:
        word = "later" if delay.value > 0.0 else "earlier"
        what = "" if parts else f"{effect} "
        parts.append(f"{what}{abs(delay.value):.0f} ms {word} at {delay.hz:.2g} Hz ({_range(delay, 'ms')})")
    return ", and ".join(parts)


def _range(size: Size, unit: str) -> str:
    return f"{size.low:+.0f} to {size.high:+.0f} {unit}".replace("-", "\N{MINUS SIGN}")


def _signal(recipe: Recipe, name: str) -> str:
    """A signal as people call it: its description up to the first comma."""
    return recipe.signals[name].description.partition(",")[0] or name


def date_of(start_ns: int | None) -> str:
    """ "3 May 2026", or "" where the log does not know."""
    if start_ns is None:
        return ""
    day = datetime.fromtimestamp(start_ns * 1e-9, UTC)
    return f"{day.day} {day:%b %Y}"


def short_names(vehicles: Collection[str]) -> dict[str, str]:
    """What to call vehicles: the shortest end of each name that no other has; `--vehicle` takes it."""
    every = sorted(vehicles)
    return {name: one_line(shortest_end(name, every)) if name else NAMELESS for name in every}


@dataclass(frozen=True)
class Smallest:
    """The change of an ordinary vehicle that would have been flagged in nine of ten, alone in its fleet."""

    gain_pct: float
    delay_ms: float


def smallest(judged: JudgedChannel, tests: int, rate: float) -> Smallest | None:
    """Of the same change of gain, or the same delay, at all frequencies; None without a test.

    `tests`: how many are made in all, of which one alone must pass the strictest step.
    `rate`: of false discoveries.
    """
    own = [t for t in judged.tests if t.question == "changed"]
    if not own or tests < 1:
        return None
    omega = judged.band.frequencies
    k = len(omega)
    freedom = _median([t.freedom for t in own])
    limit = float(stats.f.isf(rate / tests, 2 * k, freedom))

    def missing(strength: float) -> float:
        return float(stats.ncf.sf(limit, 2 * k, freedom, strength)) - SEEN

    needed = brentq(missing, 1e-6, 1e4 * (1.0 + limit))
    gain = np.concatenate([np.ones(k), np.zeros(k)])
    delay = np.concatenate([np.zeros(k), omega])
    return Smallest(
        100.0 * float(np.expm1(_median([_amount(t, gain, needed) for t in own]))),
        1e3 * _median([_amount(t, delay, needed) for t in own]),
    )


def _amount(test: Test, direction: FloatArray, needed: float) -> float:
    return float(np.sqrt(needed / (direction @ np.linalg.solve(test.covariance, direction))))


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))
