"""An interactive page of a flight: fields over time, with modes, messages and parameter changes."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from flysid.dataset import FloatArray
from flysid.escaping import one_line
from flysid.ingest.lake.timeline import Timeline, Trace
from flysid.validate.show.page.decimate import extremes
from flysid.validate.show.page.html import environment, load_asset, script_json, security_policy
from flysid.version import __version__


def render_flights(timelines: Sequence[Timeline], title: str, most_samples: int = 2_000_000) -> str:
    """The page; it loads nothing and keeps every peak.

    `timelines`: one section each, one below the other.
    `title`: of the page.
    `most_samples`: in all lines together. Where there are more, a line keeps the extremes of as many samples
        at a time as it takes, and the page says so.
    """
    count = sum(len(trace.values) for t in timelines for panel in t.panels for trace in panel)
    size = max(1, -(-2 * count // max(1, most_samples))) if count > most_samples else 1
    styles = "\n".join(load_asset(name) for name in ("uPlot.min.css", "page.css", "plot.css"))
    scripts = [load_asset("uPlot.iife.min.js"), load_asset("plot.js")]
    return (
        environment()
        .get_template("plot.html.j2")
        .render(
            csp=security_policy(scripts, styles),
            title=one_line(title),
            styles=Markup(styles),
            scripts=[Markup(script) for script in scripts],
            data=Markup(script_json([timeline_document(t, size) for t in timelines])),
            flights=[
                {"name": one_line(t.name), "moments": t.moments, "clock": one_line(t.clock)}
                for t in timelines
            ],
            thinned=size if size > 1 else 0,
            version=__version__,
        )
    )


def timeline_document(timeline: Timeline, size: int) -> dict[str, Any]:
    """What the page's script draws; `size` samples at a time become their extremes."""
    return {
        "panels": [[_trace(trace, size) for trace in panel] for panel in timeline.panels],
        "modes": [[start, end, one_line(name)] for start, end, name in timeline.modes],
        "moments": [[m.time_s, m.kind, one_line(m.text)] for m in timeline.moments],
    }


def _trace(trace: Trace, size: int) -> dict[str, str]:
    kept = extremes(trace.values, size)
    return {
        "name": one_line(trace.name),
        "unit": one_line(trace.unit),
        "t": _pack(trace.time_s[kept]),
        "v": _pack(trace.values[kept]),
    }


def _pack(values: FloatArray) -> str:
    """Little-endian float64 in base64: four times smaller than digits, and exact."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f8").tobytes()).decode()
