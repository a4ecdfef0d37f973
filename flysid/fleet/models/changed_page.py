"""The page of a compared fleet: which vehicles changed and how, and which were not judged."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from flysid.escaping import one_line
from flysid.fleet.models.changed import FleetComparison
from flysid.fleet.models.differences import JudgedChannel, Test
from flysid.fleet.models.flag_words import Flag, date_of
from flysid.model.polynomials import Z95
from flysid.showing import first_of, rough_duration
from flysid.validate.show.page.html import environment, load_asset, security_policy, write_page
from flysid.validate.show.page.masthead import dates
from flysid.validate.show.page.svg import Axes, dots, frame, picture, segment, span, text
from flysid.version import __version__

SHOWN = 8
"""Names in a sentence."""


def write_fleet_page(
    path: Path, compared: FleetComparison, command: str, reports: Mapping[str, Path] | None = None
) -> Path:
    """Write the page whole or not at all; returns its path.

    `command`: that makes it again.
    `reports`: vehicle -> the page of its own run.
    Raises StoreError: the file cannot be written.
    """
    links = {v: os.path.relpath(page, path.parent) for v, page in (reports or {}).items()}
    return write_page(path, render(compared, command, links))


def render(compared: FleetComparison, command: str, links: Mapping[str, str] | None = None) -> str:
    """The page; equal comparisons give equal pages."""
    styles = load_asset("page.css")
    title, lead = headline(compared)
    return (
        environment()
        .get_template("fleet.html.j2")
        .render(
            csp=security_policy([], styles),
            styles=Markup(styles),
            version=__version__,
            title=title,
            lead=lead,
            basis=_basis(compared),
            masthead=_masthead(compared),
            vehicles=_vehicles(compared, links or {}),
            channels=[_channel(compared, judged) for judged in compared.channels],
            unseen=_unseen(compared),
            command=one_line(command),
            provenance=[
                ("recipe", compared.recipe.name),
                ("false discoveries", f"{100.0 * compared.rate:.0f} % of the flagged at most"),
                ("tests", str(sum(len(j.tests) for j in compared.channels))),
                ("versions", f"flysid {__version__}"),
            ],
        )
    )


def headline(compared: FleetComparison) -> tuple[str, str]:
    """How many vehicles have changed, and how many differ from the others."""
    changed = {f.vehicle for f in compared.findings if f.question == "changed"}
    unlike = {f.vehicle for f in compared.findings} - changed
    many = len(compared.names)
    title = f"{len(changed)} of {many} vehicles {'has' if len(changed) == 1 else 'have'} changed"
    if not changed:
        title = "These flights show no change in any vehicle"
    more = " more" if changed else ""
    one = len(unlike) == 1
    lead = f"{len(unlike)}{more} {'differs' if one else 'differ'} from the fleet." if unlike else ""
    return title, lead


def _basis(compared: FleetComparison) -> str:
    when = "the first half of each vehicle's flights with the second"
    if compared.before_ns is not None:
        when = f"flights before {date_of(compared.before_ns)} with those from then on"
    return (
        f"Compares {when}, and every vehicle with the others, by gain and phase where output and input are "
        "coherent. Wind and trim are taken from each flight, and what all vehicles have in common from the "
        f"change. Of the flagged, {100.0 * compared.rate:.0f} % may be false."
    )


def _masthead(compared: FleetComparison) -> list[str]:
    flights = compared.flights
    firmwares = sorted({f.info["firmware"] for f in flights if f.info.get("firmware")})
    facts = [
        f"{len(compared.names)} vehicles",
        f"{len(flights)} flights",
        f"{rough_duration(sum(f.duration_s for f in flights))} in total",
        dates([f.start_utc_ns for f in flights if f.start_utc_ns is not None]),
        f"firmware {first_of(firmwares, SHOWN)}" if firmwares else "",
    ]
    return [one_line(fact) for fact in facts if fact]


def _vehicles(compared: FleetComparison, links: Mapping[str, str]) -> list[dict[str, Any]]:
    """One card for each flagged vehicle, those that have changed first."""
    own: dict[str, list[Flag]] = {}
    for found in sorted(compared.findings, key=lambda f: (f.question != "changed", f.p)):
        own.setdefault(found.vehicle, []).append(found)
    by_name = {name: vehicle for vehicle, name in compared.names.items()}
    cards = []
    for name, every in own.items():
        changed = [f for f in every if f.question == "changed"]
        cards.append(
            {
                "name": name,
                "css": "worse" if changed else "unsure",
                "badge": "has changed" if changed else "unlike the fleet",
                "sentences": [
                    f"{f.channel}: {f.sentence.removeprefix(f'{name}: ')}" for f in changed or every
                ],
                "link": links.get(by_name[name], ""),
            }
        )
    return cards


def _channel(compared: FleetComparison, judged: JudgedChannel) -> dict[str, Any]:
    spec = compared.recipe.channel(judged.channel)
    least = compared.smallest.get(judged.channel)
    hz = judged.band.frequencies / 2.0 / np.pi
    own = [t for t in judged.tests if t.question == "changed"]
    at = _surest(own, len(hz))
    common = ""
    if judged.common is not None and np.any(judged.common):
        common = f"{100.0 * np.expm1(judged.common[at]):+.1f} % gain from early to late".replace("-", "−")
    return {
        "name": one_line(judged.channel),
        "signals": f"{judged.sampling.inputs[0]} → {judged.sampling.outputs[0]}",
        "strip": strip(own, compared.names, at),
        "caption": f"Change of gain at {hz[at]:.2g} Hz, percent, with 95 % intervals; vehicles by name. "
        "Red: flagged, at this frequency or another.",
        "frequencies": ", ".join(f"{f:.2g}" for f in hz) + " Hz",
        "smallest": f"{least.gain_pct:.0f} % of gain or {least.delay_ms:.0f} ms, in nine of ten"
        if least
        else "",
        "common": common,
        "shows": one_line(spec.shows),
        "hides": one_line(spec.hides),
    }


def _surest(tests: Sequence[Test], k: int) -> int:
    """The frequency at which most is known of gains."""
    return int(np.argmin(np.median([t.sigmas[:k] for t in tests], axis=0))) if tests else 0


def strip(tests: Sequence[Test], names: Mapping[str, str], at: int) -> Markup:
    """All vehicles' changes of gain at one frequency, with intervals, the flagged by name."""
    values = np.array([100.0 * np.expm1(t.difference[at]) for t in tests])
    ends = [(100.0 * np.expm1(t.difference[at] + s * Z95 * t.sigmas[at])) for t in tests for s in (-1, 1)]
    axes = Axes((-1.0, float(max(len(tests), 1))), span(values, np.array(ends), around=0.0))
    parts = [frame(axes, "change of gain, %", "vehicles", x_ticks=False)]
    parts.append(segment(axes.left, float(axes.py(0.0)), axes.right, float(axes.py(0.0)), "zero"))
    for i, test in enumerate(tests):
        low, high = (float(axes.py(e)) for e in ends[2 * i : 2 * i + 2])
        x = float(axes.px(float(i)))
        css = "ci worse" if test.flagged else "whisker"
        parts.append(segment(x, low, x, high, css))
        if test.flagged:
            is_above = values[i] < 0.0 and high > axes.top + 12
            parts.append(text(x, high - 4 if is_above else low + 11, names[test.vehicle], anchor="middle"))
    calm = np.array([not t.flagged for t in tests], dtype=bool)
    place = np.arange(len(tests), dtype=np.float64)
    parts.append(dots(axes, place[calm], values[calm], "dot"))
    flagged = ", ".join(names[t.vehicle] for t in tests if t.flagged) or "none"
    return picture(400, 180, parts, f"Change of gain of {len(tests)} vehicles; flagged: {flagged}")


def _unseen(compared: FleetComparison) -> list[tuple[str, str]]:
    """Channels and vehicles that were not judged, and why."""
    notes = [(f"Channel {one_line(name)}", one_line(why)) for name, why in compared.skipped.items()]
    reasons: dict[str, dict[str, list[str]]] = {}
    for judged in compared.channels:
        for vehicle, why in judged.too_few.items():
            reasons.setdefault(why, {}).setdefault(compared.names[vehicle], []).append(judged.channel)
    for why, vehicles in reasons.items():
        count = len(vehicles)
        what = (
            f"{count} vehicles: {first_of(sorted(vehicles), SHOWN)}"
            if count > 1
            else f"Vehicle {next(iter(vehicles))}"
        )
        channels = sorted({c for own in vehicles.values() for c in own})
        whom = "themselves" if count > 1 else "itself"
        notes.append((what, f"not compared with {whom} in {', '.join(channels)}: {one_line(why)}"))
    if not any(t.question == "unlike" for j in compared.channels for t in j.tests):
        notes.append(("The fleet", "too few vehicles to find one that is unlike the others"))
    return notes
