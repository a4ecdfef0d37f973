"""`flysid ls DATA`: the flights of an ingested folder, from its catalogue alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.display import Display, progress_options
from flysid.cli.output import align_columns, explain
from flysid.cli.source import READING_OF_A_FIT, opened_flights, selection_options
from flysid.extras import Missing
from flysid.showing import clock

if TYPE_CHECKING:
    from flysid.catalogue import FlightFacts
    from flysid.ingest.lake.chosen_flights import Selection

HEADINGS = ("FLIGHT", "FORMAT", "VEHICLE", "TIME", "STREAMS", "RECORDS", "LOST")


@click.command("ls")
@click.argument("data", default="data", type=SOURCE)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option(
    "--suggest", is_flag=True, help="Show which channels the flights can identify, good ones first."
)
@click.option("--all", "every", is_flag=True, help="With --suggest: also what cannot be used.")
@selection_options
@progress_options
def command(
    data: Path,
    as_json: bool,
    suggest: bool,
    every: bool,
    selection: Selection,
    display: Display,
) -> None:
    """List flights, or what they can identify.

    DATA is an ingested folder, a log, a folder of logs or a quoted pattern.
    """
    if suggest:
        _suggest(data, selection, display, as_json, every)
        return
    from flysid.ingest.lake.chosen_flights import select

    with display.shown(), opened_flights(data, selection=selection) as lake:
        flights = select(lake, selection).facts
    if as_json:
        click.echo(json.dumps({"flights": [as_document(f) for f in flights]}, indent=1))
    else:
        click.echo("\n".join(align_columns([HEADINGS, *(row(f) for f in flights)])))


def _suggest(data: Path, selection: Selection, display: Display, as_json: bool, every: bool) -> None:
    from flysid.cli.suggestions import print_suggestions
    from flysid.ingest.lake.chosen_flights import select, vehicle_words
    from flysid.progress import part

    missing = Missing()
    with display.shown(), opened_flights(data, share=READING_OF_A_FIT, selection=selection) as whole:
        lake = select(whole, selection)
        with part(READING_OF_A_FIT), missing.gathering():
            found = lake.suggest()
        vehicles = vehicle_words(lake)
        flights = [facts.id for facts in lake.facts]
    if as_json:
        document = {"suggestions": [s.to_dict() for s in found], **missing.to_dict()}
        click.echo(json.dumps(document, indent=1))
    else:
        print_suggestions(found, flights, str(data), every, vehicles)
    for sentence in missing.sentences:
        explain(sentence)


def row(flight: FlightFacts) -> tuple[str, ...]:
    """One flight as the cells of a table."""
    from flysid.facts.vehicle import label_of

    return (
        flight.id,
        flight.format,
        label_of(flight.info),
        clock(flight.duration_s, padded=True),
        str(len(flight.streams)),
        f"{flight.rows:,}",
        "yes" if flight.lost else "-",
    )


def as_document(flight: FlightFacts) -> dict[str, Any]:
    """One flight for `--json`."""
    return {
        "id": flight.id,
        "format": flight.format,
        "sha256": flight.sha256,
        "size_bytes": flight.size_bytes,
        "duration_s": flight.duration_s,
        "records": flight.rows,
        "lossy": flight.lossy,
        "losses": flight.losses,
        "info": dict(flight.info),
        "streams": dict(flight.streams),
    }
