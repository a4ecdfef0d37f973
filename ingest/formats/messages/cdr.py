"""ROS 1 and CDR (ROS 2) messages of one type, decoded together: one pass over the type, not over messages.

Every message has a cursor; all cursors move through the type at once. A run of fixed-size fields is one
gather of all messages' bytes and one structured view. A string or sequence reads its lengths, gathers
what they span, and moves each cursor by its own amount, so layouts that vary by message (std_msgs/Header
with its frame_id) cost little more than fixed ones. Only sequences of elements that themselves vary are
walked element by element, all messages abreast.

In CDR a value is aligned to its own size (at most 8, or 4 in XCDR2) counted from the end of the 4-byte
encapsulation header; the alignment of an empty sequence's elements is not applied. ROS 1 packs everything.

A message that does not fit its type gets `bad` and reads zeros from then on; the others are untouched.

A message ends where its type ends. Two surpluses are none: zeros up to a multiple of 4 bytes, which DDS pads
to, and what rmw_serialize of ROS 2 leaves when it sizes a buffer: it makes room for aligning the elements
of empty sequences. `Cursors.drift` follows that size, and is believed unless the messages that need no such
room go on as well. Any other surplus means that the message is of another type, whose values would be read
wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from flysid.ingest.formats.common import arrow_arrays
from flysid.ingest.formats.common.gather import Bytes, Index, Values, numbers, rows, runs, spread
from flysid.ingest.formats.messages.steps import (
    Elements,
    FixedFields,
    Leaf,
    NumberSequence,
    Step,
    TextStep,
    Wire,
    largest_run,
)

MAX_STEPS = 50_000  # element-by-element steps over all sequences of one batch
CACHE_BYTES = 1 << 18

Columns = list[tuple[str, pa.Array]]


class UnevenError(ValueError):
    """Sequences of varying elements too long to be walked."""


@dataclass
class Cursors:
    """One place per message. `data` ends with `zeros` bytes of zeros, where bad messages read.

    `drift` is how far behind `at` a message would be, had the elements of its empty sequences been aligned.
    """

    data: Bytes
    at: Index
    end: Index
    origin: Index
    wire: Wire
    zeros: int
    budget: list[int] = field(default_factory=lambda: [MAX_STEPS])
    bad: NDArray[np.bool_] = field(init=False)
    drift: Index = field(init=False)

    def __post_init__(self) -> None:
        self.bad = np.zeros(len(self.at), dtype=np.bool_)
        self.drift = np.zeros(len(self.at), dtype=np.int64)

    def fail(self, which: NDArray[np.bool_]) -> None:
        """Mark messages as bad; they read zeros from now on."""
        if which.any():
            self.bad |= which

    def align(self, size: int) -> None:
        unit = min(size, self.wire.align)
        if unit > 1:
            self.at += -(self.at - self.origin) % unit

    def take(self, size: Index | int) -> Index:
        """Starts of the next `size` bytes of every message, which are passed; zeros where they do not fit."""
        self.fail(self.at + size > self.end)
        start = np.where(self.bad, len(self.data) - self.zeros, self.at) if self.bad.any() else self.at
        self.at = self.at + size
        return start

    def counts(self, floor: int) -> Index:
        """The u32 counts of what follows, each element of which takes at least `floor` bytes."""
        self.align(4)
        found = numbers(self.data, self.take(4), self.wire.order + "u4").astype(np.int64)
        self.fail(found * floor > self.end - self.at)
        return np.where(self.bad, 0, found) if self.bad.any() else found

    def part(self, keep: Index, at: Index) -> Cursors:
        """Cursors of elements that start at `at`, inside messages `keep`."""
        inner = Cursors(self.data, at, self.end[keep], self.origin[keep], self.wire, self.zeros, self.budget)
        inner.bad = self.bad[keep]
        inner.drift = self.drift[keep]
        return inner

    def skip_gaps(self, unit: int, count: Index, *, room: bool) -> None:
        """Align to `unit` before the elements of sequences; with `room` `drift` aligns empty ones too."""
        has_any = count > 0
        gap = np.where(has_any, -(self.at - self.origin) % unit, 0)
        drifted = np.where(has_any | room, -(self.at + self.drift - self.origin) % unit, 0)
        self.at = self.at + gap
        self.drift = self.drift + drifted - gap

    def has_surplus(self) -> NDArray[np.bool_]:
        """Which messages go on behind their type."""
        left = self.end - self.at
        over = np.where(left >= self.drift, left - self.drift, left)
        sure = (self.drift == 0) & ~self.bad
        if 2 * int((left > 3)[sure].sum()) > int(sure.sum()):  # most go on where nothing can explain it
            over = left
        for k in np.flatnonzero((over > 0) & (over < 4) & ((self.end - self.origin) % 4 == 0)).tolist():
            if self.wire.align > 1 and not self.data[self.end[k] - over[k] : self.end[k]].any():
                over[k] = 0
        surplus: NDArray[np.bool_] = (over != 0) & ~self.bad
        return surplus


def decode(
    data: Bytes, at: Index, size: Index, steps: tuple[Step, ...], wire: Wire
) -> tuple[Columns, Index, int]:
    """Columns of the messages data[at : at + size], the numbers of those that fit, how many go on behind it.

    `data` must end with `largest_run(steps)` zeros. Columns have one row per message, bad ones included.

    Raises
    ------
    UnevenError : sequences of varying elements are too long to be walked.
    """
    cursors = Cursors(data, at.copy(), at + size, at, wire, largest_run(steps))
    columns = _decode_steps(cursors, steps)
    surplus = cursors.has_surplus()
    return columns, np.flatnonzero(~cursors.bad & ~surplus), int(surplus.sum())


def _decode_steps(cursors: Cursors, steps: tuple[Step, ...]) -> Columns:
    columns: Columns = []
    for step in steps:
        if isinstance(step, FixedFields):
            columns += _decode_run(cursors, step)
        elif isinstance(step, TextStep):
            text = _decode_wide(cursors) if step.is_wide else _decode_text(cursors)
            columns.append((step.path, text))
        elif isinstance(step, NumberSequence):
            columns.append((step.path, _decode_numbers(cursors, step.dtype)))
        else:
            columns.append((step.path, _decode_elements(cursors, step)))
    return columns


def _decode_run(cursors: Cursors, run: FixedFields) -> Columns:
    """Columns of a run, filled in passes that stay in the processor's cache."""
    unit = run.unit(cursors.wire)
    phase = (cursors.at - cursors.origin) % unit if unit > 1 else np.zeros(len(cursors.at), dtype=np.int64)
    one = len(phase) == 0 or bool((phase == phase[0]).all())
    phases = np.unique(phase[:1] if one else phase).tolist() or [0]
    layouts = {p: run.layout(p, cursors.wire) for p in phases}
    sizes = np.zeros(unit, dtype=np.int64)
    sizes[phases] = [layouts[p][1] for p in phases]
    if cursors.drift.any():
        drifted = (phase + cursors.drift) % unit
        for p in np.unique(drifted).tolist():
            cursors.drift[drifted == p] += run.layout(p, cursors.wire)[1]
        cursors.drift -= sizes[phase]
    starts = cursors.take(int(sizes[phases[0]]) if one else sizes[phase])
    columns = [_empty(leaf, len(phase)) for leaf in run.leaves]
    for p, (kind, size) in layouts.items():
        which = slice(None) if one else np.flatnonzero(phase == p)
        _fill(columns, cursors.data, starts, (which, kind, size))
    return [(leaf.path, _leaf_array(leaf, values)) for leaf, values in zip(run.leaves, columns, strict=True)]


def _fill(
    columns: list[Values], data: Bytes, starts: Index, group: tuple[slice | Index, np.dtype[np.void], int]
) -> None:
    """Write one group of messages, those numbered `which`, into the columns."""
    which, kind, size = group
    own = starts[which]
    step = max(1, CACHE_BYTES // max(size, 1))
    for first in range(0, len(own), step):
        table = rows(data, own[first : first + step], size).view(kind)
        into = slice(first, first + step) if isinstance(which, slice) else which[first : first + step]
        for k, values in enumerate(columns):
            values[into] = table[str(k)]


def _empty(leaf: Leaf, count: int) -> Values:
    shape = count if leaf.count is None else (count, leaf.count)
    return np.empty(shape, dtype="u1" if leaf.dtype == "b1" else leaf.dtype)


def _leaf_array(leaf: Leaf, values: Values) -> pa.Array:
    if leaf.dtype == "b1":
        values = values != 0
    return arrow_arrays.numeric(values) if leaf.count is None else arrow_arrays.matrix(values)


def _decode_text(cursors: Cursors) -> pa.Array:
    size = cursors.counts(1)
    start = cursors.take(size)
    if cursors.wire.nul and len(size):  # a text that ends without one is read whole
        size = size - ((size > 0) & (cursors.data[start + np.maximum(size - 1, 0)] == 0))
    return arrow_arrays.text(runs(cursors.data, start, size), size)


def _decode_wide(cursors: Cursors) -> pa.Array:
    wide = cursors.wire.wide
    size = cursors.counts(1 if wide.counts_bytes else wide.unit) * (1 if wide.counts_bytes else wide.unit)
    start = cursors.take(size)
    code = f"utf-{8 * wide.unit}-{'be' if cursors.wire.order == '>' else 'le'}"
    texts = []
    for k, (begin, length) in enumerate(zip(start.tolist(), size.tolist(), strict=True)):
        try:
            texts.append(cursors.data[begin : begin + length].tobytes().decode(code).rstrip("\0"))
        except UnicodeDecodeError:
            texts.append("")
            cursors.bad[k] = True
    return pa.array(texts, pa.string())


def _decode_numbers(cursors: Cursors, dtype: str) -> pa.Array:
    kind = np.dtype(cursors.wire.order + ("u1" if dtype == "b1" else dtype))
    count = cursors.counts(kind.itemsize)
    unit = min(kind.itemsize, cursors.wire.align)
    if unit > 4:  # after the count every place is aligned to 4
        cursors.skip_gaps(unit, count, room=True)
    cursors.fail(cursors.at + count * kind.itemsize > cursors.end)
    count = np.where(cursors.bad, 0, count)
    start = cursors.take(count * kind.itemsize)
    if kind.itemsize > 1 and len(count) and count.min() != count.max():
        places = spread_elements(start, count, kind.itemsize)
        values = rows(cursors.data, places, kind.itemsize).view(kind)
    else:
        values = runs(cursors.data, start, count * kind.itemsize).view(kind)
    return arrow_arrays.lists(arrow_arrays.numeric(values != 0 if dtype == "b1" else values), count)


def spread_elements(start: Index, count: Index, stride: int) -> Index:
    """Places of `count` elements `stride` bytes apart, for every start."""
    steps = spread(np.zeros_like(count), count)
    return np.repeat(start, count) + steps * stride


def _decode_elements(cursors: Cursors, step: Elements) -> pa.Array:
    if step.size is None:
        count = cursors.counts(1)
    else:
        cursors.fail(cursors.end - cursors.at < step.size)
        count = np.where(cursors.bad, 0, step.size).astype(np.int64)
    columns = _even_elements(cursors, step, count) or _uneven_elements(cursors, step, count)
    if step.single:
        child = columns[0][1]
    else:
        child = arrow_arrays.structs([name for name, _ in columns], [array for _, array in columns])
    return arrow_arrays.lists(child, count)


def _even_elements(cursors: Cursors, step: Elements, count: Index) -> Columns | None:
    """Elements of one fixed size, all at once; None where they vary."""
    if len(step.steps) != 1 or not isinstance(step.steps[0], FixedFields):
        return None
    run = step.steps[0]
    wire = cursors.wire
    unit = run.unit(wire)
    if run.leads(wire):
        cursors.skip_gaps(unit, count, room=False)
    elif cursors.drift.any():
        return None
    phases = np.unique((cursors.at - cursors.origin)[count > 0] % unit)
    sizes = {run.layout(p, wire)[1] for p in phases.tolist()} or {1}
    size = sizes.pop()
    stride = size + (-size % unit if run.leads(wire) else 0)
    if sizes or stride % unit:
        return None
    span = np.where(count > 0, (count - 1) * stride + size, 0)
    cursors.fail(span > cursors.end - cursors.at)
    count[cursors.bad] = 0
    places = spread_elements(cursors.at, count, stride)
    owner = np.repeat(np.arange(len(count)), count)
    cursors.at = cursors.at + np.where(count > 0, span, 0)
    return _decode_run(cursors.part(owner, places), run)


def _uneven_elements(cursors: Cursors, step: Elements, count: Index) -> Columns:
    """Elements that vary: the k-th of every message together, for k = 0, 1, ..."""
    longest = int(count.max()) if len(count) else 0
    cursors.budget[0] -= longest
    if cursors.budget[0] < 0:
        raise UnevenError(f"sequence {step.path} has {longest} elements of varying size")
    layers: list[Columns] = []
    owners: list[Index] = []
    for k in range(longest):
        active = np.flatnonzero(count > k)
        inner = cursors.part(active, cursors.at[active])
        layers.append(_decode_steps(inner, step.steps))
        owners.append(active)
        cursors.at[active] = inner.at
        cursors.bad[active] |= inner.bad
        cursors.drift[active] = inner.drift
    if not layers:
        none = np.empty(0, dtype=np.int64)
        return _decode_steps(cursors.part(none, none), step.steps)
    order = arrow_arrays.numeric(np.argsort(np.concatenate(owners), kind="stable"))
    return [
        (name, pa.concat_arrays([layer[c][1] for layer in layers]).take(order))
        for c, (name, _) in enumerate(layers[0])
    ]
