"""What `flysid ls DATA --suggest` prints: the channels each flight supports, and how well."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from flysid.ingest.suggest import Suggestion

HEADINGS = (
    "FLIGHT",
    "RECIPE",
    "CHANNEL",
    "RATE",
    "TIME",
    "INPUT",
    "COHERENCE",
    "SIGN",
    "BAND",
    "DELAY",
    "VERDICT",
)


def print_suggestions(data: str, as_json: bool) -> None:
    """A table on stdout with the advice below it, or JSON."""
    from flysid.cli.ls import aligned
    from flysid.cli.output import printable, say
    from flysid.ingest.lake import open as open_lake

    found = open_lake(data).suggest()
    if as_json:
        click.echo(json.dumps({"suggestions": [s.to_dict() for s in found]}, indent=1))
        return
    if not found:
        say("no shipped recipe has its streams in these flights; write a recipe of your own")
        return
    click.echo("\n".join(aligned([HEADINGS, *(row(s) for s in found)])))
    for text in advice(found):
        click.echo(printable(text))
    if any(s.feedback for s in found):
        click.echo(
            "loop: the input answers the output too (pilot or controller); see the docs on closed loops"
        )


def row(found: Suggestion) -> tuple[str, ...]:
    """One suggestion as the cells of a table."""
    made = found.rate_hz > 0
    return (
        found.flight,
        found.recipe,
        found.channel,
        f"{found.rate_hz:.4g} Hz" if made else "-",
        f"{found.duration_s:.0f} s" if made else "-",
        f"{found.input_rms:.2g} {found.input_unit} rms" if made else "-",
        f"{found.coherence:.2f}" if made else "-",
        {1: "+", -1: "-"}.get(found.sign if found.band_hz else 0, ""),
        f"{found.band_hz[0]:.2g}-{found.band_hz[1]:.2g} Hz" if found.band_hz else "none",
        _delay(found),
        found.verdict,
    )


def _delay(found: Suggestion) -> str:
    """Dead time with what cannot be told from it; nothing where no band shows a relation."""
    if found.delay_s is None or found.band_hz is None:
        return "-"
    low_ms, high_ms = 1e3 * (found.delay_low_s or 0.0), 1e3 * (found.delay_high_s or 0.0)
    loop = " loop" if found.feedback else ""
    return f"{1e3 * found.delay_s:.0f} ms [{low_ms:.0f}, {high_ms:.0f}]{loop}"


def advice(found: list[Suggestion]) -> list[str]:
    """What stands in the way, each once, with the channels it concerns."""
    grouped: dict[str, list[str]] = {}
    for suggestion in found:
        for text in (suggestion.advice, *suggestion.notes):
            if text:
                grouped.setdefault(text, []).append(f"{suggestion.flight} {suggestion.channel}")
    return [
        f"{', '.join(places[:4])}{', ...' if len(places) > 4 else ''}: {t}" for t, places in grouped.items()
    ]
