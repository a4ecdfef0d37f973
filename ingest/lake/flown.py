"""How much of a log was flown, by the conditions of the shipped recipes: armed, airborne, radio link up.

Only what the log states counts. A log that states neither arming nor landing was flown for an unknown time,
and a state counts only while something was measured: parameters are stamped with the time at which they were
read, minutes before the log began.

Of the streams that conditions ask for only the changes are kept, so that a log of any size stays small.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pyarrow as pa

from flysid.flight import BOOT, TIME, ClockMap, message_of, stem_of
from flysid.flightwriter import int_values
from flysid.ingest.align.conditions import condition_spans
from flysid.ingest.align.recipe import Condition, Source, load_recipe, shipped_recipes
from flysid.ingest.align.resample import Span
from flysid.ingest.align.signals import Log
from flysid.ingest.align.values import base_column, column_values
from flysid.ingest.formats.common.arrow_arrays import numeric
from flysid.ingest.formats.keyed import key_fields
from flysid.ingest.lake.events import MESSAGES, PARAMETERS

DEFINITIONS = ("FMT", "FMTU", "UNIT", "MULT", "VER", "EV", "events")
STATED = frozenset([*DEFINITIONS, *(name for name, *_ in (*MESSAGES, *PARAMETERS))])
"""Messages of which a row may be stamped long before the log began, or long after it."""

IN_THE_AIR = ("armed", "airborne")
"""Names of the conditions that say whether a vehicle flies; a radio link, say, does not."""
ARMED_BY_FLAGS = Condition("armed", (Source("slow", ("flightModeFlags",)),), has_bits=1)
"""Betaflight and INAV: the first of the flags in every release."""


@cache
def _conditions() -> tuple[Condition, ...]:
    """Those of shipped recipes that are about every flight; of one name the first with a source counts."""
    found = (c for name in shipped_recipes() for c in load_recipe(name).conditions)
    whole = tuple(replace(c, margin_s=0.0) for c in found if not c.required and not c.channels)
    return *whole, ARMED_BY_FLAGS


@cache
def _asked_of(message: str) -> tuple[str, ...]:
    """The fields of a message that conditions look at."""
    sources = (s for c in _conditions() for s in c.sources if s.stream == message)
    return tuple(dict.fromkeys(s.fields[0] for s in sources))


@dataclass(frozen=True)
class Kept:
    """The rows at which a field changes that a condition asks for, as a `Log`.

    `rows`: of every stream of the log, also of those that are not kept.
    `tables`: stream key -> what is kept of it.
    """

    name: str
    rows: Mapping[str, int]
    info: Mapping[str, str]
    tables: Mapping[str, pa.Table]

    @property
    def clocks(self) -> Sequence[ClockMap]:
        return ()

    @property
    def allowed(self) -> None:
        return None

    def columns(self, stream: str) -> Sequence[str]:
        return self.tables[stream].column_names if stream in self.tables else ()

    def keys(self, stream: str) -> Sequence[str]:
        return key_fields(self.tables[stream].schema) if stream in self.tables else ()

    def table(self, stream: str, columns: Sequence[str]) -> pa.Table:
        return self.tables[stream].select(list(columns))


@dataclass(frozen=True)
class Flown:
    """When a log was flown.

    `spans`: boot -> when all conditions hold; None where the log states none of them.
    `never`: of each condition that never holds, what the log has instead.
    """

    spans: Mapping[int, tuple[Span, ...]] | None = None
    never: tuple[str, ...] = ()

    @property
    def seconds(self) -> float | None:
        """Vehicle time in the air; None where it is unknown."""
        if self.spans is None:
            return None
        return 1e-9 * sum(last - first for spans in self.spans.values() for first, last in spans)


def flown(log: Log, measured: Mapping[int, Span]) -> Flown:
    """When a log was flown.

    `measured`: boot -> from when to when anything was measured, ns; see `is_measured`.
    """
    never = condition_spans(_conditions(), log).never
    stated = condition_spans([c for c in _conditions() if c.name in IN_THE_AIR], log).spans
    if not stated:
        return Flown(None, never)
    return Flown({boot: within(stated.get(boot, ()), span) for boot, span in measured.items()}, never)


def flown_of(log: Log) -> Flown:
    """When a log was flown whose tables can be read."""
    measured: dict[int, Span] = {}
    for stream in filter(is_measured, log.rows):
        if log.rows[stream] < 2:
            continue
        table = log.table(stream, [BOOT, TIME])
        boots, times = int_values(table[BOOT]), int_values(table[TIME])
        for boot in np.unique(boots).tolist():
            inside = times[boots == boot]
            widen(measured, boot, (int(inside.min()), int(inside.max())))
    return flown(log, measured)


def is_measured(stream: str) -> bool:
    """Whether a stream holds what was measured, not parameters, definitions, messages or events."""
    return stem_of(message_of(stream)).partition("#")[0] not in STATED


def widen(spans: dict[int, Span], boot: int, span: Span) -> None:
    """Let the span of a boot reach over another."""
    first, last = spans.get(boot, span)
    spans[boot] = min(first, span[0]), max(last, span[1])


def within(spans: Iterable[Span], limits: Span) -> tuple[Span, ...]:
    """What of some spans lies within limits."""
    cut = ((max(a, limits[0]), min(b, limits[1])) for a, b in spans)
    return tuple((a, b) for a, b in cut if a < b)


def changes(stream: str, table: pa.Table) -> pa.Table | None:
    """The rows of a part at which something changes that a condition asks for; None where none asks."""
    message = message_of(stream).partition("#")[0]
    columns = list(
        dict.fromkeys(filter(None, (base_column(c, table.column_names) for c in _asked_of(message))))
    )
    if not columns or not table.num_rows:
        return None
    new = np.zeros(table.num_rows, dtype=bool)
    new[0] = True
    for name in (BOOT, *columns):
        values = column_values(table, name)
        new[1:] |= values[1:] != values[:-1]
    return table.select([TIME, BOOT, *columns]).filter(numeric(new))
