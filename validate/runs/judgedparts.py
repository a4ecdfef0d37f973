"""A verdict on some of the held-out data: these flights, these minutes, this flight mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from flysid.dataset import Dataset, Segment
from flysid.errors import DataError, UsageError
from flysid.ingest.align.allowed import CHOOSE_AGAIN
from flysid.ingest.align.resample import FOREVER, Span, intersect
from flysid.ingest.lake.chosen_flights import Selection, select
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.lake import open as open_lake
from flysid.validate.runs.run import HeldOut, Run


def chosen_lake(run: Run, data: str | Path | None, selection: Selection) -> Lake:
    """The flights of a run that are meant.

    Raises UsageError: the run was fitted to a dataset file; or as `select`.
    """
    if not run.recipe:
        raise UsageError("a dataset file has no flights to choose from", path=run.data)
    return select(open_lake(data or run.data).only(run.flights), selection)


def restrict(held: HeldOut, lake: Lake) -> HeldOut:
    """Only what of the held-out part lies in the flights and stretches of a folder.

    Raises DataError: nothing of it does.
    """
    turns = tuple(replace(turn, test=_within(turn.test, lake)) for turn in held.turns)
    test = _within(held.test, lake)
    if not test.segments:
        raise _nothing_left(held, lake)
    return replace(held, test=test, turns=tuple(turn for turn in turns if turn.test.segments))


def _nothing_left(held: HeldOut, lake: Lake) -> DataError:
    """Why nothing is left to judge on: what is asked for never holds, or was not held out."""
    flights = {name.partition("#")[0] for name in held.test.flights}
    never = dict.fromkeys(why for log in lake.logs if log.name in flights for why in log.allowed.never)
    if never:
        return DataError("; ".join(never), hint=CHOOSE_AGAIN)
    return DataError(
        "none of the chosen data was held out",
        hint=f"choose among what was held out: {', '.join(held.test.flights)}",
    )


def _within(data: Dataset, lake: Lake) -> Dataset:
    spans = {log.name: log.allowed.spans for log in lake.logs}
    kept: list[Segment] = []
    for segment in data.segments:
        flight, _, boot = segment.flight.partition("#")
        if flight not in spans:
            continue
        own = spans[flight]
        allowed = [span for key in ([int(boot)] if boot else own) for span in own.get(key, ())]
        kept += _cut(segment, allowed if own else [(-FOREVER, FOREVER)], data.dt_s)
    return data.with_segments(kept)


def _cut(segment: Segment, allowed: Sequence[Span], dt_s: float) -> list[Segment]:
    """The parts of a segment that lie in spans of time."""
    step = dt_s * 1e9
    whole = (segment.t0_ns, segment.t0_ns + round(len(segment) * step))
    parts = []
    for start, end in intersect([whole], sorted(allowed)):
        first = int(np.ceil((start - segment.t0_ns) / step))
        last = int(np.ceil((end - segment.t0_ns) / step))
        if last - first >= 2:
            rows = slice(first, last)
            at = segment.t0_ns + round(first * step)
            parts.append(replace(segment, u=segment.u[rows], y=segment.y[rows], t0_ns=at))
    return parts
