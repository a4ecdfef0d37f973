"""Rows of one message that belong to several things: a stream for each thing.

A reader names the fields that tell things apart in its schema's metadata, from what the log or its dialect
declares (`KEY`). The rows are split here, in one place for every format, so that no verb ever meets two gyros
in one column. A thing's stream is named by the values of its key: `IMU[0]`, `NAMED_VALUE_FLOAT[alt_err]`, of
two fields `FSB[1,0]`.

Where nothing is declared and a field's name suggests it (`KEY_IF_SEVERAL`), a stream with one thing keeps its
plain name. That is known at the end only: the first thing's stream is renamed then.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from urllib.parse import quote, unquote

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from flysid.flight import KEY, KEY_IF_SEVERAL, OTHERS

_KINDS = (KEY, KEY_IF_SEVERAL)
_BETWEEN = "\x1f"  # of the names of a list, while they are one text
_SAFE = "".join(chr(c) for c in range(32, 127) if chr(c) not in ",%")  # stands as it is
IntArray = npt.NDArray[np.int64]


class KeyedStreams:
    """Splits the tables of a log; knows which things it has met.

    Parameters
    ----------
    most : streams that are made in all. Rows of things that come later stay together as `STREAM (others)`: a
        damaged or forged log may name any number of things, each of which would become a file.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._met: set[str] = set()
        self._first: dict[str, str] = {}
        self.joined: dict[str, int] = {}
        """Stream -> rows that stayed together beyond `most`."""
        self.renamed: dict[str, str] = {}
        """Stream -> what it is called now that another thing has been met."""

    def split(self, stream: str, table: pa.Table) -> Iterator[tuple[str, pa.Table]]:
        """The streams that the rows of a table belong to, in the order of their keys, with their rows."""
        about = table.schema.metadata or {}
        columns = key_fields(table.schema)
        is_declared = bool(columns) and KEY.encode() in about
        if not columns:
            yield stream, table
            return
        if not table.num_rows:
            return
        late: list[IntArray] = []
        for thing, rows in _things(table, columns):
            name = f"{stream}[{thing}]"
            if not is_declared and self._is_first(stream, name):
                name = stream
            elif not self._admits(name):
                late.append(np.arange(table.num_rows) if rows is None else rows)
                continue
            yield name, table if rows is None else take_rows(table, rows)
        if late:
            rows = np.sort(np.concatenate(late))
            self.joined[stream] = self.joined.get(stream, 0) + len(rows)
            yield stream + OTHERS, take_rows(table, rows)

    def _is_first(self, stream: str, name: str) -> bool:
        """Whether a thing is the first of its stream; where it is not, the first one needs its name, too."""
        first = self._first.setdefault(stream, name)
        if first != name:
            self.renamed[stream] = first
        return first == name

    def _admits(self, name: str) -> bool:
        """Whether a thing has a stream of its own."""
        if name not in self._met and len(self._met) < self._most:
            self._met.add(name)
        return name in self._met


def key_fields(schema: pa.Schema) -> tuple[str, ...]:
    """The columns of a schema that tell to which of several things a row belongs."""
    about = schema.metadata or {}
    named = keys_in({kind: about[kind.encode()].decode() for kind in _KINDS if kind.encode() in about})
    if not named:
        return ()
    kinds = {field.name: field.type for field in schema}
    return tuple(name for name in named if _can_tell(kinds.get(name)))


def keys_in(metadata: Mapping[str, str]) -> tuple[str, ...]:
    """The fields that a schema's metadata names as its key."""
    named = next((metadata[kind] for kind in _KINDS if metadata.get(kind)), "")
    return tuple(named.split(",")) if named else ()


def _can_tell(kind: pa.DataType | None) -> bool:
    """Whether the values of a column can be those of a key: one value a row, or a list of names."""
    return kind is not None and (not pa.types.is_nested(kind) or kind == pa.list_(pa.string()))


def take_rows(table: pa.Table, rows: IntArray) -> pa.Table:
    """Some rows of a table, in the order given, without importing pandas."""
    return table.take(pa.Array.from_buffers(pa.int64(), len(rows), [None, pa.py_buffer(rows)]))


def thing_name(texts: Sequence[str]) -> str:
    """The name of a thing from the texts of its key's fields: of several no comma inside them remains."""
    return texts[0] if len(texts) == 1 else ",".join(quote(text, safe=_SAFE) for text in texts)


def thing_texts(name: str, count: int) -> list[str]:
    """The texts of the `count` fields of a key from a thing's name."""
    return [name] if count == 1 else [unquote(text) for text in name.split(",")]


def _things(table: pa.Table, columns: tuple[str, ...]) -> list[tuple[str, IntArray | None]]:
    """The name of each thing and its rows, rising; None where all rows are of one thing."""
    codes, texts = _coded(table[columns[0]])
    parts: list[tuple[str, ...]] = [(text,) for text in texts]
    for column in columns[1:]:
        more, others = _coded(table[column])
        codes = codes.astype(np.int64) * len(others) + more
        parts = [(*part, other) for part in parts for other in others]
    if len(parts) == 1:
        return [(thing_name(parts[0]), None)]
    order = np.argsort(codes, kind="stable")
    ranked = codes[order]
    edges = [0, *(np.flatnonzero(ranked[1:] != ranked[:-1]) + 1).tolist(), len(order)]
    names = [thing_name(parts[int(code)]) for code in ranked[edges[:-1]]]
    if len(names) == 1:
        return [(names[0], None)]
    return [(name, order[first:end]) for name, (first, end) in zip(names, pairwise(edges), strict=True)]


def _coded(column: pa.ChunkedArray) -> tuple[npt.NDArray[np.integer], list[str]]:
    """(n,) numbers that stand for the values of a column, and each number's text; no text twice."""
    values = _as_they_lie(column)
    if values is not None and (values == values[0]).all():
        return np.zeros(len(values), np.int64), [str(values[0])]
    is_list = pa.types.is_list(column.type)
    column = pc.binary_join(column, _BETWEEN) if is_list else column
    encoded = column.combine_chunks().dictionary_encode()
    if isinstance(encoded, pa.ChunkedArray):
        encoded = encoded.unify_dictionaries().combine_chunks()
    indices = encoded.indices
    texts = [thing_text(value) for value in encoded.dictionary.to_pylist()]
    if indices.null_count:  # `fill_null` imports pandas
        indices = indices.fill_null(len(texts))
        texts.append("")
    if is_list:
        texts = [thing_name(text.split(_BETWEEN)) for text in texts]
    codes = np.frombuffer(indices.buffers()[1], np.int32, len(indices), indices.offset * 4)
    places = {text: place for place, text in enumerate(dict.fromkeys(texts))}
    if len(places) < len(texts):  # no value beside an empty one, -0.0 beside 0.0
        codes = np.array([places[text] for text in texts])[codes]
    return codes, list(places)


def _as_they_lie(column: pa.ChunkedArray) -> npt.NDArray[np.integer] | None:
    """(n,) whole numbers of a column in one piece and without nulls; None for others."""
    if column.num_chunks != 1 or not pa.types.is_integer(column.type) or column.null_count:
        return None
    chunk = column.chunk(0)
    size = column.type.bit_width // 8
    letter = "u" if pa.types.is_unsigned_integer(column.type) else "i"
    return np.frombuffer(chunk.buffers()[1], f"{letter}{size}", len(chunk), chunk.offset * size)


def thing_text(value: object) -> str:
    """A key's value in an address: whole numbers without a fraction."""
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)
