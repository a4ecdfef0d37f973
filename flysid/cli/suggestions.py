"""What `flysid ls DATA --suggest` prints: the channels each flight supports, and how well."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import click

from flysid.cli.output import align_columns, say, shorten
from flysid.cli.pooled_suggestions import HEADINGS as POOLED_HEADINGS
from flysid.cli.pooled_suggestions import dead_time, hertz, pool, pooled_advice
from flysid.escaping import one_line
from flysid.showing import counted, fold

if TYPE_CHECKING:
    from flysid.ingest.lake.suggest import Suggestion

HEADINGS = ("FLIGHT", "CHANNEL", "INPUT", "TIME", "RATE", "COH.", "BAND, Hz", "DEAD TIME, ms")
ORDER = ("good", "closed loop", "weak", "too slow", "too short", "too quiet", "excluded")
USABLE = ("good", "closed loop", "weak")
NEXT = {"good": "fit", "closed loop": "tf"}
COHERENCE = "COH.: coherence, the share of the output's power that a linear model of the input can explain"
LOOP = "loop: the input reacts to the output (a pilot or controller); see docs/recipes.md on closed loops"
OPEN = "?: the data do not determine it"
SIGN = "+, - before an input: the output moves with it, or against it"


def print_suggestions(
    found: Sequence[Suggestion],
    flights: Sequence[str],
    data: str,
    every: bool,
    vehicles: Mapping[str, str],
) -> None:
    """Tables on stdout, the good ones first, with the advice below them.

    Several flights are summarised together, a row for every channel.

    `flights`: all that were looked at; one without a usable channel gets a line with the reason.
    `every`: show every flight, and what cannot be used, too.
    `vehicles`: flight -> what `--vehicle` takes, where there are several.
    """
    names = short_names([*flights, *(s.flight for s in found)])
    shown = [s for s in found if every or s.verdict in USABLE]
    together = not every and len({s.flight for s in shown}) > 1
    lines: list[str] = []
    for verdict in ORDER:
        for recipe in dict.fromkeys(s.recipe for s in shown if s.verdict == verdict):
            group = [s for s in shown if (s.verdict, s.recipe) == (verdict, recipe)]
            rows = [row(s, names[s.flight]) for s in sorted(group, key=lambda s: -s.coherence)]
            table = [POOLED_HEADINGS, *pool(group)] if together else [HEADINGS, *rows]
            lines += [f"{verdict.upper()}  {recipe}", *(f"  {line}" for line in align_columns(table)), ""]
    delays = [_delay(s) for s in shown if s.rate_hz > 0]
    lines += [SIGN] if any(s.sign and s.band_hz is not None for s in shown) else []
    lines += [COHERENCE] if shown else []
    lines += [LOOP] if any("loop" in cell for cell in delays) else []
    lines += [OPEN] if any("?" in cell for cell in delays) else []
    lines += pooled_advice(shown, names) if together else advice(shown, names)
    lines += unusable(found, flights, names, told=every)
    lines += _more(len(found) - len(shown), together)
    click.echo("\n".join(fold(one_line(line)) for line in lines).strip())
    say(next_command(found, data, vehicles))


def _more(hidden: int, together: bool) -> list[str]:
    """What `--all` would show besides."""
    unused = f"{counted(hidden, 'channel')} that cannot be used" if hidden else ""
    each = "every flight by itself" if together else ""
    return [f"{' and '.join(part for part in (each, unused) if part)}: --all"] if unused or each else []


def unusable(
    found: Sequence[Suggestion], flights: Sequence[str], names: Mapping[str, str], *, told: bool = False
) -> list[str]:
    """A line for every flight without a usable channel, with the first reason and its remedy.

    `told`: reasons stand above.
    """
    lines = []
    for flight in flights:
        own = [s for s in found if s.flight == flight]
        if not own:
            lines.append(
                f"{shorten(names[flight])}: no shipped recipe fits; name an input and an output yourself"
            )
        elif not told and not any(s.verdict in USABLE for s in own):
            first = own[0]
            lines.append(f"{shorten(names[flight])}: {first.channel} {first.verdict}: {first.advice}")
    return lines


def next_command(found: Sequence[Suggestion], data: str, vehicles: Mapping[str, str]) -> str:
    """What to run next: the recipe with most that is good, and its good channels, of one vehicle.

    Where all that would be good was flown in closed loop, `flysid tf` tells what of it is the vehicle's.
    """
    if not found:
        return f"next: 'flysid show {data} --fields' lists the fields; name two to 'flysid fit': --from, --to"
    best = next((verdict for verdict in NEXT if any(s.verdict == verdict for s in found)), "")
    if not best:
        return f"next: fly or log what is asked for above; to look at this flight: flysid plot {data}"
    chosen = [s for s in found if s.verdict == best]
    vehicle = Counter(vehicles.get(s.flight, "") for s in chosen).most_common(1)[0][0]
    own = [s for s in found if vehicles.get(s.flight, "") == vehicle]
    recipe = Counter(s.recipe for s in own if s.verdict == best).most_common(1)[0][0]
    channels = dict.fromkeys(s.channel for s in own if s.recipe == recipe and s.verdict == best)
    rest = {s.channel for s in own if s.recipe == recipe} - channels.keys()
    words = "".join(f" -c {channel}" for channel in channels) if rest else ""
    words += f" --vehicle {shlex.quote(vehicle)}" if vehicle else ""
    verb = NEXT[best]
    return f"next: flysid {verb} {data} --recipe {recipe}{words}" + (" -o run" if verb == "fit" else "")


def row(found: Suggestion, flight: str) -> tuple[str, ...]:
    """One suggestion as the cells of a table."""
    made = found.rate_hz > 0
    related = made and found.band_hz is not None
    band = found.band_hz or (0.0, 0.0)
    return (
        shorten(flight),
        found.channel,
        {1: "+", -1: "-", 0: ""}[found.sign if related else 0] + shorten(found.input, 13),
        f"{found.duration_s:.0f} s" if made else "-",
        f"{found.rate_hz:.3g} Hz" if made else "-",
        f"{found.coherence:.2f}" if made else "-",
        f"{hertz(band[0])} to {hertz(band[1])}" if related else "none" if made else "-",
        _delay(found) if related else "-",
    )


def short_names(flights: Sequence[str]) -> dict[str, str]:
    """Every flight -> its name without the hash, where that names one flight only."""
    short = {f: f.rpartition("-")[0] or f for f in dict.fromkeys(flights)}
    return {f: s if list(short.values()).count(s) == 1 else f for f, s in short.items()}


def _delay(found: Suggestion) -> str:
    """Dead time, and what cannot be distinguished from it."""
    from flysid.ingest.lake.suggest import unbounded

    if found.delay_s is None:
        return "-"
    loop = " loop" if found.feedback else ""
    if unbounded(found):
        return f"?{loop}"
    return f"{dead_time(found.delay_s, found.delay_low_s or 0.0, found.delay_high_s or 0.0)}{loop}"


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
