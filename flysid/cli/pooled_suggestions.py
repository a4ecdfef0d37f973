"""What several flights can identify, one row a channel: ninety rows would not be read."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from statistics import median
from typing import TYPE_CHECKING

from flysid.showing import counted

if TYPE_CHECKING:
    from flysid.ingest.lake.suggest import Suggestion

HEADINGS = ("CHANNEL", "INPUT", "FLIGHTS", "TIME", "RATE", "COH.", "BAND, Hz", "DEAD TIME, ms")
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.]*\w)")
"""A number that stands alone, not the one in `motor1`."""


def pool(found: Sequence[Suggestion]) -> list[tuple[str, ...]]:
    """The rows of suggestions of one verdict and recipe: the most coherent channel first."""
    channels: dict[str, list[Suggestion]] = {}
    for suggestion in found:
        channels.setdefault(suggestion.channel, []).append(suggestion)
    best_first = sorted(channels.values(), key=lambda own: -median(s.coherence for s in own))
    return [_row(own) for own in best_first]


def _row(own: Sequence[Suggestion]) -> tuple[str, ...]:
    """One channel of several flights: sums, ranges, and the middle of the dead times."""
    inputs = list(dict.fromkeys(s.input for s in own))
    signs = {s.sign for s in own if s.band_hz is not None}
    sign = {1: "+", -1: "-"}.get(signs.pop(), "") if len(signs) == 1 and len(inputs) == 1 else ""
    made = [s for s in own if s.rate_hz > 0]
    related = [s for s in made if s.band_hz is not None]
    bands = [s.band_hz for s in made if s.band_hz is not None]
    rates = [s.rate_hz for s in made]
    coherences = [s.coherence for s in made]
    return (
        own[0].channel,
        f"{sign}{inputs[0]}" if len(inputs) == 1 else counted(len(inputs), "input"),
        str(len({s.flight for s in own})),
        f"{sum(s.duration_s for s in made):.0f} s" if made else "-",
        f"{spread(min(rates), max(rates), '.3g')} Hz" if made else "-",
        spread(min(coherences), max(coherences), ".2f") if made else "-",
        _band(bands) if bands else "none" if made else "-",
        _delay(related),
    )


def _band(bands: Sequence[tuple[float, float]]) -> str:
    """From the lowest to the highest frequency, Hz."""
    return f"{hertz(min(low for low, _ in bands))} to {hertz(max(high for _, high in bands))}"


def spread(low: float, high: float, form: str) -> str:
    """ "0.84 to 1.00", or one number where both print alike."""
    first, last = f"{low:{form}}", f"{high:{form}}"
    return first if first == last else f"{first} to {last}"


def hertz(value: float) -> str:
    """Two digits, and never as a power of ten."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"


def _delay(related: Sequence[Suggestion]) -> str:
    """The median of the flights' dead times and how far they reach, of those that determine it."""
    from flysid.ingest.lake.suggest import unbounded

    told = [s for s in related if s.delay_s is not None and not unbounded(s)]
    loop = " loop" if any(s.feedback for s in related) else ""
    if not told:
        return f"?{loop}" if related else "-"
    middle = median(s.delay_s for s in told if s.delay_s is not None)
    low = min(s.delay_low_s or 0.0 for s in told)
    high = max(s.delay_high_s or 0.0 for s in told)
    return f"{dead_time(middle, low, high)}{loop}"


def dead_time(value_s: float, low_s: float, high_s: float) -> str:
    """ "40 (35-46)", in milliseconds."""
    return f"{1e3 * value_s:.0f} ({1e3 * low_s:.0f}-{1e3 * high_s:.0f})"


def pooled_advice(found: Sequence[Suggestion], names: Mapping[str, str]) -> list[str]:
    """What stands in the way, each once; what differs in numbers and inputs alone is one, with ranges."""
    alike: dict[str, list[tuple[Suggestion, str]]] = {}
    for suggestion in found:
        for text in (suggestion.advice, *suggestion.notes):
            if text:
                said = text.replace(f"follows {suggestion.input}", "follows the input")
                alike.setdefault(NUMBER.sub("#", said), []).append((suggestion, said))
    lines = []
    for those in alike.values():
        flights: dict[str, dict[str, None]] = {}
        for suggestion, _ in those:
            flights.setdefault(suggestion.channel, {})[names[suggestion.flight]] = None
        places = [
            f"{channel} ({next(iter(of)) if len(of) == 1 else counted(len(of), 'flight')})"
            for channel, of in flights.items()
        ]
        lines.append(f"{', '.join(places)}: {_with_ranges([text for _, text in those])}")
    return lines


def _with_ranges(texts: Sequence[str]) -> str:
    """Texts that differ in their numbers alone, as one: "9 to 23 %"."""
    columns = iter(list(zip(*(NUMBER.findall(text) for text in texts), strict=True)))

    def range_of(_: re.Match[str]) -> str:
        values = sorted(next(columns), key=float)
        return values[0] if values[0] == values[-1] else f"{values[0]} to {values[-1]}"

    return NUMBER.sub(range_of, texts[0])
