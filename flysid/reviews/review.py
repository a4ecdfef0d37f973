"""Review a log: compute every section; one that fails leaves the others intact."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import FormatError, UsageError
from flysid.extras import Extra, Missing, extra
from flysid.flight import split_address
from flysid.ingest.lake.crash import end_at_crash
from flysid.ingest.lake.timeline import Timeline, Trace, happenings, with_gaps
from flysid.progress import tell
from flysid.reviews.fact import Fact, Section
from flysid.reviews.figures import own_limits, withhold
from flysid.reviews.logged import Column, LoggedFlight
from flysid.reviews.reviewed import NO_TIMELINE, Review

SECTIONS: Mapping[str, str] = {
    "tracking": "flysid.reviews.tracking",
    "vibration": "flysid.reviews.vibration",
    "power": "flysid.reviews.power",
    "estimator": "flysid.reviews.estimator",
    "happened": "flysid.reviews.happened",
    "trust": "flysid.reviews.trust",
}
"""Key of a section -> the module whose `review` computes it."""


def load_sections() -> None:
    """Import what the sections need: while another process reads the log, it costs no time."""
    for module in SECTIONS.values():
        import_module(module)


def review(
    path: str | Path,
    page: str | Path | None = None,
    *,
    limits: Mapping[str, tuple[float, float]] | None = None,
    recipe: str = "",
) -> Review:
    """Review one log: does the vehicle fly well, and what should be changed?

    Parameters
    ----------
    path : a log of any format that flysid reads.
    page : write the page to this file, too.
    limits : figure, such as "power.motor_spread" -> your own limits: from which value on it is to be
        watched, and bad, in the figure's unit.
    recipe : a shipped recipe or a .toml file, by which a table's columns are read: see `LoggedFlight`.

    Raises
    ------
    UsageError : there is no such file, or it is a folder or archive of several flights; a figure of
        `limits` has none.
    FormatError : nothing of it can be read.
    StoreError : the page cannot be written.

    Examples
    --------
    >>> found = flysid.review("sample_logs/01-multisine-seed1.tlog")
    >>> found.to_dict()["log"]
    '01-multisine-seed1.tlog'
    """
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.lake.batch import ingest_logs
    from flysid.ingest.lake.finding import find_logs
    from flysid.ingest.lake.lake import open as open_lake
    from flysid.ingest.lake.workers import Bounds

    with TemporaryDirectory() as folder:
        place = Path(folder) / "data"
        results = list(ingest_logs(find_logs([Path(path)], Bounds()), place, bounds=Bounds()))
        if results[0].skipped:
            raise FormatError(results[0].reason, path=results[0].path)
        logs = open_lake(place).logs
        if len(logs) != 1:
            raise UsageError(f"it holds {len(logs)} flights", path=path, hint=f"flysid review {path}")
        (stored,) = logs
        own = load_recipe(recipe) if recipe else None
        flight = LoggedFlight(stored, stored.manifest.damage, stored.manifest.source.name, recipe=own)
        with own_limits(limits or {}):
            found = review_flight(flight, with_evidence=page is not None)
    if page is not None:
        from flysid.reviews.page import write_review

        write_review(page, [found])
    return found


def review_flight(flight: LoggedFlight, *, with_evidence: bool = False) -> Review:
    """All sections of one flight; what breaks in one of them leaves the others as they are.

    `with_evidence`: read the fields behind the figures over time, too: a page shows them.
    """
    sections = []
    broken = Missing()
    timeline = NO_TIMELINE
    with broken.gathering():
        flight = extra(Extra.REVIEWED, partial(end_at_crash, flight), None, of="crash") or flight
        for i, key in enumerate(SECTIONS):
            if not with_evidence:
                flight.forget()
            tell(f"reviewing: {key}", log=flight.name, share=i / len(SECTIONS))
            made = extra(Extra.REVIEWED, partial(_review, key, flight), None, of=key)
            if made is not None:
                sections.append(made)
        facts = [fact for section in sections for fact in section.facts]
        if with_evidence:
            timeline = extra(Extra.REVIEW_PICTURE, partial(_evidence, flight, facts), timeline, of="evidence")
        flight.forget()
    return Review(
        flight.name,
        flight.info,
        flight.clock,
        tuple(sections),
        tuple(broken.sentences),
        flight.whole_parameters,
        timeline,
    )


def _review(key: str, flight: LoggedFlight) -> Section:
    review: Callable[[LoggedFlight], Section] = import_module(SECTIONS[key]).review
    found = review(flight)
    return withhold(found, flight.flight_s) if flight.was_flown else found


def _evidence(flight: LoggedFlight, facts: Iterable[Fact]) -> Timeline:
    """The fields of facts, in their order: those of one fact and unit share a panel.

    A column is given up as its trace is made, and traces of a stream share their times: either is large.
    """
    panels: list[tuple[Trace, ...]] = []
    times: dict[str, FloatArray] = {}
    for fact in facts:
        new = [flight.read.pop(a) for a in dict.fromkeys(fact.fields) if a in flight.read]
        units = dict.fromkeys(column.unit for column in new)
        panels += [tuple(_trace(column, times) for column in new if column.unit == unit) for unit in units]
    seen = happenings(flight.log, flight.clock.offsets_s, flight.duration_s)
    return Timeline(flight.name, tuple(panels), *seen, flight.clock.words)


def _trace(column: Column, times: dict[str, FloatArray]) -> Trace:
    """A column with its pauses; `times` holds those of the traces before, by stream, and takes its own."""
    time_s, values = with_gaps(column.time_s, column.values)
    stream, _ = split_address(column.address)
    before = times.get(stream)
    if before is not None and np.array_equal(before, time_s):
        time_s = before
    times[stream] = time_s
    return Trace(column.address, column.unit, time_s, values)
