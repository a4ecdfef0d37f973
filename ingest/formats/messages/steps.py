"""A message type as steps of decoding: runs of fixed size, texts, sequences; and how they lie on the wire."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.ingest.formats.messages.definitions import Array, DefinitionError, MessageType, Number, Text, Type

MAX_FIXED_BYTES = 1 << 26


@dataclass(frozen=True)
class Wide:
    """How the characters of a wide string lie: bytes of each, and whether the length counts bytes.

    The standard and the DDS of ROS 2 differ: Fast DDS and Cyclone DDS write 4 bytes for a character in the
    classic encoding; later ones write UTF-16, whose length counts units or bytes.
    """

    unit: int = 4
    counts_bytes: bool = False


WIDES = (Wide(), Wide(2), Wide(2, counts_bytes=True))


@dataclass(frozen=True)
class Wire:
    """How numbers lie: byte order "<" or ">", greatest alignment (1: packed), NUL after strings."""

    order: str = "<"
    align: int = 1
    wide: Wide = WIDES[0]

    @property
    def nul(self) -> bool:
        return self.align > 1


ROS1_WIRE = Wire()


@dataclass(frozen=True)
class Leaf:
    """A number, or a fixed array of `count` numbers, at a dotted path."""

    path: str
    dtype: str
    count: int | None = None


@dataclass(frozen=True)
class FixedFields:
    """Fixed-size fields one after the other."""

    leaves: tuple[Leaf, ...]

    def unit(self, wire: Wire) -> int:
        """The greatest alignment in the run: a start matters only modulo this."""
        return max(min(np.dtype(leaf.dtype).itemsize, wire.align) for leaf in self.leaves)

    def leads(self, wire: Wire) -> bool:
        """Whether the first field has the greatest alignment, so that every start is padded to it."""
        return min(np.dtype(self.leaves[0].dtype).itemsize, wire.align) == self.unit(wire)

    def layout(self, phase: int, wire: Wire) -> tuple[np.dtype[np.void], int]:
        """Structured type of the run for a start at `phase` (mod the greatest alignment), and its size."""
        at = phase
        names = []
        formats = []
        offsets = []
        for number, leaf in enumerate(self.leaves):
            kind = np.dtype(wire.order + ("u1" if leaf.dtype == "b1" else leaf.dtype))
            at += -at % min(kind.itemsize, wire.align)
            names.append(str(number))
            formats.append((kind, leaf.count) if leaf.count is not None else kind)
            offsets.append(at - phase)
            at += kind.itemsize * (1 if leaf.count is None else leaf.count)
        size = at - phase
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size}), size


@dataclass(frozen=True)
class TextStep:
    """A string at a dotted path."""

    path: str
    is_wide: bool = False


@dataclass(frozen=True)
class NumberSequence:
    """A counted sequence of numbers at a dotted path."""

    path: str
    dtype: str


@dataclass(frozen=True)
class Elements:
    """A sequence (`size` None) or fixed array of strings, messages or arrays; `single` has no inner names."""

    path: str
    steps: tuple[Step, ...]
    size: int | None
    single: bool


Step = FixedFields | TextStep | NumberSequence | Elements


def plan(kind: MessageType) -> tuple[Step, ...]:
    """The steps that decode a message type. Raises DefinitionError where its fixed part is too large."""
    steps: list[Step] = []
    pending: list[Leaf] = []
    _plan_into(kind, "", steps, pending)
    _flush(steps, pending)
    return tuple(steps)


def _plan_into(kind: Type, path: str, steps: list[Step], pending: list[Leaf]) -> None:
    if isinstance(kind, MessageType):
        for name, inner in kind.fields:
            _plan_into(inner, f"{path}.{name}" if path else name, steps, pending)
    elif isinstance(kind, Number):
        pending.append(Leaf(path, kind.dtype))
    elif isinstance(kind, Array) and isinstance(kind.element, Number) and kind.size is not None:
        pending.append(Leaf(path, kind.element.dtype, kind.size))
    else:
        _flush(steps, pending)
        steps.append(_varying(kind, path))


def _flush(steps: list[Step], pending: list[Leaf]) -> None:
    if sum(8 * (leaf.count or 1) for leaf in pending) > MAX_FIXED_BYTES:
        raise DefinitionError("fixed arrays are too large")
    if pending:
        steps.append(FixedFields(tuple(pending)))
        pending.clear()


def _varying(kind: Text | Array | Number | MessageType, path: str) -> Step:
    if isinstance(kind, Text):
        return TextStep(path, kind.is_wide)
    assert isinstance(kind, Array)
    if isinstance(kind.element, Number):
        return NumberSequence(path, kind.element.dtype)
    single = not isinstance(kind.element, MessageType)
    inner = MessageType("", (("", kind.element),)) if single else kind.element
    assert isinstance(inner, MessageType)
    return Elements(path, plan(inner), kind.size, single)


def largest_run(steps: tuple[Step, ...]) -> int:
    """An upper bound of the bytes that any one gather of fixed size takes."""
    most = 16
    for step in steps:
        if isinstance(step, FixedFields):
            most = max(most, sum(8 + 8 * (leaf.count or 1) for leaf in step.leaves))
        elif isinstance(step, Elements):
            most = max(most, largest_run(step.steps))
    return most


def has_wide(steps: tuple[Step, ...]) -> bool:
    """Whether a type has wide strings."""
    return any(
        step.is_wide if isinstance(step, TextStep) else isinstance(step, Elements) and has_wide(step.steps)
        for step in steps
    )
