"""Pictures and tables of tracking: each axis at its liveliest, all loops, and the error by mode."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flysid.ingest.lake.events import mode_changes
from flysid.reviews.fact import Picture, PictureLine, Table
from flysid.reviews.follow import telling
from flysid.reviews.tracked import MS, Followed, Tracked
from flysid.showing import significant

SHOWN = ("attitude", "rate")
"""Loops whose motion is drawn: the first that the log holds of an axis."""


def motions(tracked: Tracked) -> Iterator[Picture]:
    """One picture for roll, pitch and yaw: setpoint and measurement."""
    for axis in ("roll", "pitch", "yaw"):
        found = (tracked.of(loop, axis) for loop in SHOWN)
        followed = next((f for f in found if f is not None), None)
        if followed is not None:
            yield _motion(followed)


def _motion(followed: Followed) -> Picture:
    pair, grid = followed.pair, followed.grid
    rows = telling(grid)
    logged = grid.logged[rows]
    lines = tuple(
        PictureLine(name, grid.time_s[rows], np.where(logged, values[rows], np.nan), name)
        for name, values in (("setpoint", grid.setpoint), ("measured", grid.measured))
    )
    late = f"{MS * followed.lag.seconds:.0f} ms late, " if followed.lag.is_known else ""
    noun = pair.axis.capitalize() + (" rate" if pair.loop.key == "rate" else "")
    error = f"{late}{significant(followed.rms, 2)} {pair.loop.unit} RMS"
    return Picture(noun, "s", pair.loop.unit, lines, error)


def chain(tracked: Tracked) -> Iterator[Table]:
    """Every loop and axis, from outside to inside."""
    rows = []
    times = []
    for followed in tracked.followed:
        pair, lag = followed.pair, followed.lag
        late = "not determined"
        if lag.interval is not None:
            low, high = (f"{MS * edge:.0f}" for edge in lag.interval)
            late = f"{MS * lag.seconds:.0f} ms [{low}, {high}]"
        error = f"{significant(followed.rms)} {pair.loop.unit}"
        rows.append((pair.loop.title, pair.axis, error, late, f"{pair.rate_hz:.0f} Hz"))
        times.append(
            float(followed.grid.time_s[telling(followed.grid)][0]) if len(followed.grid.time_s) else 0.0
        )
    if rows:
        headings = ("loop", "axis", "error, RMS", "late", "logged at")
        yield Table("Every loop, from outside to inside", headings, tuple(rows), tuple(times))


def modes(tracked: Tracked, *, least_s: float = 10.0) -> Iterator[Table]:
    """How angles, or rates where no angle is logged, were followed in each mode flown for a while."""
    spans = _mode_spans(tracked)
    drawn = [f for f in tracked.followed if f.pair.loop.key == _shown_loop(tracked)]
    rows = []
    for mode in dict.fromkeys(name for name, *_ in spans):
        cells = []
        flown_s = 0.0
        for followed in drawn:
            times = followed.rows.time_s
            inside = np.zeros(len(times), dtype=bool)
            for name, first, last in spans:
                if name == mode:
                    inside |= (times >= first) & (times < last)
            part = followed.rows.during(inside)
            flown_s = max(flown_s, float(part.counts.sum()) * followed.pair.measured.period_s)
            error = part.error
            cells.append(significant(float(np.sqrt(np.mean(error**2)))) if len(error) else "")
        if flown_s >= least_s:
            rows.append((mode, f"{flown_s:.0f} s", *cells))
    if len(rows) > 1:
        unit = drawn[0].pair.loop.unit
        headings = ("mode", "flown", *(f"{f.pair.axis}, {unit} RMS" for f in drawn))
        yield Table(f"Error of the {drawn[0].pair.loop.title} by mode", headings, tuple(rows))


def _shown_loop(tracked: Tracked) -> str:
    held = {followed.pair.loop.key for followed in tracked.followed}
    return next((loop for loop in SHOWN if loop in held), "")


def _mode_spans(tracked: Tracked) -> list[tuple[str, float, float]]:
    clock = tracked.flight.clock
    changes = [
        (event.text, clock.seconds(event.boot, event.time_ns)) for event in mode_changes(tracked.flight.log)
    ]
    ends = [*(start for _, start in changes), np.inf][1:]
    return [(name, start, end) for (name, start), end in zip(changes, ends, strict=True)]
