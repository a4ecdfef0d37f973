"""How much of a log was flown, by the conditions of the shipped recipes: armed, airborne, radio link up.

Of the streams that conditions ask for only the changes are kept, so that a log of any size stays small.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pyarrow as pa

from flysid.flight import BOOT, TIME, ClockMap, message_of
from flysid.ingest.align.conditions import condition_spans
from flysid.ingest.align.recipe import Condition, load_recipe, shipped_recipes
from flysid.ingest.align.resample import Span
from flysid.ingest.align.values import base_column
from flysid.ingest.formats.keyed import key_fields


@cache
def _conditions() -> tuple[Condition, ...]:
    """Those of shipped recipes that are about every flight; of one name the first with a source counts."""
    found = (c for name in shipped_recipes() for c in load_recipe(name).conditions)
    return tuple(c for c in found if not c.required and not c.channels)


@cache
def _asked_of(message: str) -> tuple[str, ...]:
    """The fields of a message that conditions look at."""
    sources = (s for c in _conditions() for s in c.sources if s.stream == message)
    return tuple(dict.fromkeys(s.fields[0] for s in sources))


@dataclass(frozen=True)
class Kept:
    """The rows at which a field changes that a condition asks for, as a `Log`.

    Attributes
    ----------
    rows : of every stream of the log, also of those that are not kept.
    tables : stream key -> what is kept of it.
    """

    name: str
    rows: Mapping[str, int]
    info: Mapping[str, str]
    tables: Mapping[str, pa.Table]

    @property
    def allowed(self) -> None:
        return None

    def columns(self, stream: str) -> Sequence[str]:
        return self.tables[stream].column_names if stream in self.tables else ()

    def keys(self, stream: str) -> Sequence[str]:
        return key_fields(self.tables[stream].schema) if stream in self.tables else ()

    def table(self, stream: str, columns: Sequence[str]) -> pa.Table:
        return self.tables[stream].select(list(columns))

    def flown(self, clocks: Sequence[ClockMap]) -> tuple[dict[int, tuple[Span, ...]], tuple[str, ...]]:
        """Boot -> when all conditions hold, and what is to be said of those that never do."""
        allowed = condition_spans(_conditions(), self)
        whole = {clock.boot: (clock.first_ns, clock.last_ns) for clock in clocks}
        flown = {boot: within(allowed.spans.get(boot, (span,)), span) for boot, span in whole.items()}
        return flown, allowed.never


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
        values = np.asarray(table[name].to_numpy())
        new[1:] |= values[1:] != values[:-1]
    return table.select([TIME, BOOT, *columns]).filter(pa.array(new))
