"""Labels of a recipe: the vehicle's state, e.g. its flight mode; they mark segments and may cut them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.facts.modes import holds_modes, mode_texts
from flysid.flight import BOOT, TIME
from flysid.flightwriter import int_values
from flysid.ingest.align.recipe import Label
from flysid.ingest.align.resample import Span
from flysid.ingest.align.signals import Log, find_source
from flysid.ingest.align.values import base_column, column_values, names_of, texts_of

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Steps:
    """A label in one boot: (K,) times, ns, from which each of K values holds until the next."""

    name: str
    t_ns: IntArray
    values: tuple[str, ...]
    cuts: bool

    def at(self, time_ns: int) -> str:
        """The value at a time; '' before the first."""
        index = int(np.searchsorted(self.t_ns, time_ns, side="right")) - 1
        return self.values[index] if index >= 0 else ""

    def longest_in(self, span: Span) -> str:
        """The value that holds longest in a span."""
        edges = [span[0], *(int(t) for t in self.t_ns if span[0] < t < span[1]), span[1]]
        held: dict[str, int] = {}
        for start, stop in itertools.pairwise(edges):
            value = self.at(start)
            held[value] = held.get(value, 0) + stop - start
        return max(held, key=lambda v: held[v])


@dataclass(frozen=True)
class Labels:
    """The labels of one boot."""

    steps: Sequence[Steps] = field(default_factory=tuple)

    def cut(self, spans: Sequence[Span]) -> list[Span]:
        """The spans, cut where a label that cuts changes its value."""
        edges = sorted({int(t) for s in self.steps if s.cuts for t in s.t_ns})
        out: list[Span] = []
        for start, stop in spans:
            inside = [t for t in edges if start < t < stop]
            out += itertools.pairwise([start, *inside, stop])
        return out

    def marks(self, span: Span) -> dict[str, str | float]:
        """Name and value of every label in a span, where it is known."""
        found = {s.name: s.longest_in(span) for s in self.steps}
        return {name: value for name, value in found.items() if value}


def labels_of(labels: Sequence[Label], log: Log) -> Mapping[int, Labels]:
    """The labels of a log, per boot; labels without a source are left out."""
    found: dict[int, list[Steps]] = {}
    for label in labels:
        source = find_source(label.sources, log)
        if source is None:
            continue
        name = source[0].fields[0]
        table = log.table(source[1], [TIME, BOOT, base_column(name, log.columns(source[1]))])
        texts = _texts(table, source[1], name, log.info)
        boots = int_values(table[BOOT])
        times = int_values(table[TIME])
        for boot in np.unique(boots):
            rows = np.flatnonzero(boots == boot)
            rows = rows[np.argsort(times[rows], kind="stable")]
            found.setdefault(int(boot), []).append(_steps(label, times[rows], [texts[i] for i in rows]))
    return {boot: Labels(tuple(steps)) for boot, steps in found.items()}


def _texts(table: pa.Table, stream: str, name: str, info: Mapping[str, str]) -> list[str]:
    """The words of a column: modes as every verb names them, other values by the log's enumeration."""
    values = column_values(table, name)
    if holds_modes(stream, name) and values.dtype.kind in "iuf":
        return mode_texts(values, stream, name, info)
    return texts_of(values, names_of(table, stream, name, info))


def _steps(label: Label, t_ns: IntArray, values: Sequence[str]) -> Steps:
    """Only the times at which the value changes."""
    changed = [0, *(i for i in range(1, len(values)) if values[i] != values[i - 1])]
    return Steps(label.name, t_ns[changed], tuple(values[i] for i in changed), label.cut)
