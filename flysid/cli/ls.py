"""`flysid ls DATA`: the flights of an ingested folder, from its catalogue alone."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.display import Display, progress_options
from flysid.cli.output import aligned

if TYPE_CHECKING:
    from flysid.catalogue import FlightFacts

HEADINGS = ("FLIGHT", "FORMAT", "VEHICLE", "TIME", "STREAMS", "RECORDS", "LOST")


@click.command("ls")
@click.argument("data", default="data")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option(
    "--suggest", is_flag=True, help="List what each flight can identify, and what stands in the way."
)
@progress_options
def command(data: str, as_json: bool, suggest: bool, quiet: bool, display: Display) -> None:  # noqa: ARG001
    """List the flights of an ingested folder."""
    from flysid.catalogue import catalogue

    if suggest:
        from flysid.cli.suggest import print_suggestions

        print_suggestions(data, as_json, display)
        return
    flights = catalogue(data)
    if as_json:
        click.echo(json.dumps({"flights": [as_document(f) for f in flights]}, indent=1))
    else:
        click.echo("\n".join(aligned([HEADINGS, *(row(f) for f in flights)])))


def row(flight: FlightFacts) -> tuple[str, ...]:
    """One flight as the cells of a table."""
    vehicle = flight.info.get("vehicle") or flight.info.get("autopilot") or "-"
    return (
        flight.id,
        flight.format,
        vehicle,
        clock_text(flight.duration_s),
        str(len(flight.streams)),
        f"{flight.rows:,}",
        "yes" if flight.lossy else "-",
    )


def clock_text(seconds: float) -> str:
    """Minutes and seconds, with hours where there are any."""
    whole = max(0, round(seconds))
    hours, rest = divmod(whole, 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}" if hours else f"{rest // 60:02d}:{rest % 60:02d}"


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
        "info": dict(flight.info),
        "streams": dict(flight.streams),
    }
