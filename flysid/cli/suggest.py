"""What `flysid ls DATA --suggest` prints: the channels each flight supports, and how well."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from flysid.cli.display import Display
    from flysid.ingest.lake.suggest import Suggestion

HEADINGS = (
    "FLIGHT",
    "RECIPE",
    "CHANNEL",
    "INPUT",
    "MOVES",
    "RATE",
    "TIME",
    "COHERENCE",
    "SIGN",
    "BAND, Hz",
    "DEAD TIME, ms",
    "VERDICT",
)
LOOP = "loop: the input answers the output too (a pilot or controller); see docs/recipes.md on closed loops"
OPEN = "?: the data do not bound it"


def print_suggestions(data: str, as_json: bool, display: Display) -> None:
    """A table on stdout with the advice below it, or JSON."""
    from flysid.cli.output import aligned, printable, say
    from flysid.ingest.lake.lake import open as open_lake

    with display.shown():
        found = open_lake(data).suggest()
    if as_json:
        click.echo(json.dumps({"suggestions": [s.to_dict() for s in found]}, indent=1))
        return
    if not found:
        say("no shipped recipe has its streams in these flights; write a recipe of your own")
        return
    names = short_names([s.flight for s in found])
    rows = [row(s, names[s.flight]) for s in found]
    click.echo("\n".join(aligned([HEADINGS, *rows])))
    lines = advice(found, names)
    delays = [r[HEADINGS.index("DEAD TIME, ms")] for r in rows]
    lines += [LOOP] if any("loop" in cell for cell in delays) else []
    lines += [OPEN] if any("?" in cell for cell in delays) else []
    if lines:
        click.echo("\n" + "\n".join(printable(line) for line in lines))


def short_names(flights: Sequence[str]) -> dict[str, str]:
    """Every flight -> its name without the hash, where that names one flight only."""
    short = {f: f.rpartition("-")[0] or f for f in dict.fromkeys(flights)}
    return {f: s if list(short.values()).count(s) == 1 else f for f, s in short.items()}


def row(found: Suggestion, flight: str) -> tuple[str, ...]:
    """One suggestion as the cells of a table."""
    made = found.rate_hz > 0
    related = made and found.band_hz is not None
    band = found.band_hz or (0.0, 0.0)
    return (
        flight,
        found.recipe,
        found.channel,
        found.input if len(found.input) < 20 else "-",
        f"{found.input_rms:.2g} {found.input_unit} rms".replace("  ", " ") if made else "-",
        f"{found.rate_hz:.3g} Hz" if made else "-",
        f"{found.duration_s:.0f} s" if made else "-",
        f"{found.coherence:.2f}" if made else "-",
        {1: "+", -1: "-", 0: "?"}[found.sign] if related else "",
        f"{band[0]:.2g} to {band[1]:.2g}" if related else "none" if made else "-",
        _delay(found) if related else "-",
        found.verdict,
    )


def _delay(found: Suggestion) -> str:
    """Dead time with what cannot be told from it."""
    from flysid.ingest.lake.suggest import unbounded

    if found.delay_s is None:
        return "-"
    loop = " loop" if found.feedback else ""
    if unbounded(found):
        return f"?{loop}"
    low_ms, high_ms = 1e3 * (found.delay_low_s or 0.0), 1e3 * (found.delay_high_s or 0.0)
    return f"{1e3 * found.delay_s:.0f} ({low_ms:.0f} to {high_ms:.0f}){loop}"


def advice(found: Sequence[Suggestion], names: dict[str, str]) -> list[str]:
    """What stands in the way, each once, with the flights and channels it concerns."""
    grouped: dict[str, dict[str, list[str]]] = {}
    for suggestion in found:
        for text in (suggestion.advice, *suggestion.notes):
            if text:
                channels = grouped.setdefault(text, {}).setdefault(names[suggestion.flight], [])
                channels.append(suggestion.channel)
    return [f"{_places(places, len(names) > 1)}: {text}" for text, places in grouped.items()]


def _places(places: dict[str, list[str]], several: bool) -> str:
    """ "roll, pitch" of one flight; with more flights "flight-1 (roll, pitch), flight-2 (roll)"."""
    if not several:
        return ", ".join(dict.fromkeys(c for channels in places.values() for c in channels))
    said = [f"{flight} ({', '.join(dict.fromkeys(channels))})" for flight, channels in places.items()]
    return ", ".join(said[:4]) + (", ..." if len(said) > 4 else "")
