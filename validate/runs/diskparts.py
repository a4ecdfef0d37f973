"""Training and held-out parts of a dataset on disk: planned, hashed and read without holding it in memory.

Rows of a file are never copied: a part is a list of pieces, and a pass over it is a pass over the file. The
held-out part is bounded (`MOST_HELD`), because the comparison has it in memory.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.datasetfile import DatasetFile, Entry
from flysid.errors import DataError
from flysid.leakage.copies import find_copy
from flysid.showing import counted
from flysid.split import (
    BLOCKS,
    MIN_PIECE,
    By,
    Piece,
    Split,
    default_guard,
    flights_to_hold,
    held_pieces,
    resolve_way,
    way_of,
)

MOST_HELD = 300_000
"""Samples of a held-out part: enough for a verdict, and in memory."""
LOOK_ROWS = 30_000
"""First training samples, in memory, for all that is asked of the data besides the fits."""
COPY_HEAD = 20_000
"""First samples of every flight that are searched for copies of others."""


@dataclass(frozen=True)
class FilePart:
    """Pieces of the segments of a dataset file, every one a segment of its own; read block by block.

    `pieces`: in the order of the file; `Piece.segment` counts the file's `entries`.
    """

    file: DatasetFile
    pieces: tuple[Piece, ...]

    @property
    def dt_s(self) -> float:
        """Sample time."""
        return self.file.dt_s

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """Of the file."""
        return self.file.inputs

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Of the file."""
        return self.file.outputs

    def __len__(self) -> int:
        """Number of samples."""
        return sum(len(p) for p in self.pieces)

    def blocks(self) -> Iterator[tuple[int, FloatArray, FloatArray]]:
        """(piece's number, (n, n_u), (n, n_y)): all samples of the part, in order."""
        wanted: dict[int, list[tuple[int, Piece]]] = {}
        for number, piece in enumerate(self.pieces):
            wanted.setdefault(self.file.entries[piece.segment].number, []).append((number, piece))
        current = None
        at = 0
        for segment, u, y in self.file.subset([e for e in self.file.entries if e.number in wanted]).blocks():
            current, at = segment, at if segment == current else 0
            for number, piece in wanted[segment]:
                start = max(piece.start - at, 0)
                stop = min(piece.stop - at, len(y))
                if start < stop:
                    yield number, u[start:stop], y[start:stop]
            at += len(y)

    def head(self, rows: int) -> Dataset:
        """The first `rows` samples in memory, or all where there are fewer."""
        found: dict[int, list[tuple[FloatArray, FloatArray]]] = {}
        for number, u, y in self.blocks():
            found.setdefault(number, []).append((u[:rows], y[:rows]))
            rows -= min(rows, len(y))
            if rows == 0:
                break
        segments = tuple(self._segment(number, parts) for number, parts in found.items())
        return Dataset(self.dt_s, self.inputs, self.outputs, segments, self.file.name)

    def read(self) -> Dataset:
        """The whole part in memory."""
        return self.head(len(self))

    def content_hash(self) -> str:
        """sha256 over sample time, signals and all samples, row by row: it hangs on no size of block."""
        digest = hashlib.sha256(repr((self.dt_s, self.inputs, self.outputs)).encode())
        current = -1
        for number, u, y in self.blocks():
            if number != current:
                digest.update(f"segment of {len(self.pieces[number])}".encode())
                current = number
            digest.update(np.ascontiguousarray(np.hstack([u, y])).tobytes())
        return digest.hexdigest()

    def _segment(self, number: int, parts: Sequence[tuple[FloatArray, FloatArray]]) -> Segment:
        piece = self.pieces[number]
        entry = self.file.entries[piece.segment]
        return Segment(
            u=np.concatenate([u for u, _ in parts]),
            y=np.concatenate([y for _, y in parts]),
            t0_ns=entry.t0_ns + round(piece.start * self.dt_s * 1e9),
            flight=entry.flight,
            marks=entry.marks,
        )


def whole(file: DatasetFile) -> FilePart:
    """All of a file."""
    return FilePart(file, tuple(Piece(i, 0, e.rows) for i, e in enumerate(file.entries)))


def plan_on_disk(file: DatasetFile, *, holdout: float, by: By = "auto", seed: int = 0) -> Split:
    """Choose the held-out part as `flysid.split.plan_split` does, with at most `MOST_HELD` samples.

    By flight, what a held-out flight has beyond that serves neither part. Raises DataError: too few flights
    or samples; one flight is a copy of another, on the other side.
    """
    entries = file.entries
    size: dict[str, int] = {}
    for e in entries:
        size[e.flight] = size.get(e.flight, 0) + e.rows
    way = resolve_way(by, len(size))
    guard = default_guard(file.dt_s) if way == "time" else 0.0
    rng = np.random.default_rng(seed)
    if way == "flight":
        held = flights_to_hold(size, min(holdout * sum(size.values()), MOST_HELD), rng)
        train = [Piece(i, 0, e.rows) for i, e in enumerate(entries) if e.flight not in held]
        test = [Piece(i, 0, e.rows) for i, e in enumerate(entries) if e.flight in held]
    else:
        train, test = _by_time(entries, size, (holdout, round(guard / file.dt_s)), rng)
    test = _bound(test)
    if not train or not test:
        raise DataError(
            f"too little data to hold out {100.0 * holdout:.0f} % by {way}: {len(file)} samples in "
            f"{counted(len(entries), 'segment')}",
            hint="add flights, or longer ones",
        )
    _refuse_copies(file, train, test)
    return Split(
        by=way,
        seed=seed,
        holdout=holdout,
        guard_s=guard,
        train=tuple(train),
        test=tuple(test),
        data_sha256=whole(file).content_hash(),
        test_sha256=FilePart(file, tuple(test)).content_hash(),
    )


def plan_held_on_disk(
    file: DatasetFile, held: Mapping[str, Sequence[tuple[int, int]]], *, seed: int = 0
) -> Split:
    """Hold out what is named as `flysid.split.plan_held` does, with at most `MOST_HELD` samples.

    Raises DataError: nothing lies in the spans, or nothing beside them; a copy is held out.
    """
    guard = default_guard(file.dt_s)
    rows = [(e.flight, e.t0_ns, e.rows) for e in file.entries]
    train, test = held_pieces(rows, file.dt_s, held, guard)
    test = _bound(test)
    _refuse_copies(file, train, test)
    way = way_of(rows, train, test)
    return Split(
        by=way,
        seed=seed,
        holdout=sum(map(len, test)) / len(file),
        guard_s=guard if way == "time" else 0.0,
        train=tuple(train),
        test=tuple(test),
        data_sha256=whole(file).content_hash(),
        test_sha256=FilePart(file, tuple(test)).content_hash(),
    )


def parts_of(split: Split, file: DatasetFile) -> tuple[FilePart, FilePart]:
    """(train, test) of the file that was split. Raises DataError: `file` does not hold what was split."""
    if whole(file).content_hash() != split.data_sha256:
        raise DataError(
            "the data are not those that were split: their hash differs",
            hint="fit again, or give the data the models were fitted on",
        )
    return FilePart(file, split.train), FilePart(file, split.test)


def _by_time(
    entries: Sequence[Entry], size: Mapping[str, int], share: tuple[float, int], rng: np.random.Generator
) -> tuple[list[Piece], list[Piece]]:
    """Blocks of every flight, a tenth of its rows each, some held out; guards around them serve neither.

    `share`: what to hold out, and rows of a guard.
    """
    holdout, guard = share
    train: list[Piece] = []
    test: list[Piece] = []
    for flight, rows in size.items():
        count = int(np.clip(rows // (2 * MIN_PIECE), 2, BLOCKS))
        edges = np.linspace(0, rows, count + 1).astype(int).tolist()
        chosen = sorted(rng.permutation(count)[: int(np.clip(round(holdout * count), 1, count - 1))].tolist())
        held = [(edges[i], edges[i + 1]) for i in chosen]
        before = 0
        for index, entry in enumerate(entries):
            if entry.flight != flight:
                continue
            inside = [(max(a - before, 0), min(b - before, entry.rows)) for a, b in held]
            test += [Piece(index, a, b) for a, b in _join(inside) if b - a >= MIN_PIECE]
            near = _join([(a - guard, b + guard) for a, b in inside if a < b])
            train += [Piece(index, a, b) for a, b in _between(near, entry.rows) if b - a >= MIN_PIECE]
            before += entry.rows
    return sorted(train, key=_place), sorted(test, key=_place)


def _place(piece: Piece) -> tuple[int, int]:
    return piece.segment, piece.start


def _join(spans: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Sorted spans, those that touch as one, empty ones left out."""
    found: list[tuple[int, int]] = []
    for a, b in sorted(s for s in spans if s[0] < s[1]):
        if found and a <= found[-1][1]:
            found[-1] = found[-1][0], max(b, found[-1][1])
        else:
            found.append((a, b))
    return found


def _between(spans: Sequence[tuple[int, int]], rows: int) -> list[tuple[int, int]]:
    """What of [0, rows) lies outside the spans."""
    edges = [0, *(edge for span in spans for edge in span), rows]
    return [(max(a, 0), min(b, rows)) for a, b in zip(edges[::2], edges[1::2], strict=True) if a < b]


def _bound(pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces, the same share of each, so that all together have at most `MOST_HELD` samples."""
    kept = min(1.0, MOST_HELD / max(sum(len(p) for p in pieces), 1))
    cut = [replace(p, stop=p.start + max(int(kept * len(p)), min(len(p), MIN_PIECE))) for p in pieces]
    return cut[: max(1, MOST_HELD // MIN_PIECE)]


def _refuse_copies(file: DatasetFile, train: Sequence[Piece], test: Sequence[Piece]) -> None:
    """Refuse a held-out flight whose beginning repeats that of a training flight.

    Raises DataError: names the two.
    """
    seen: dict[tuple[bool, str], int] = {}
    heads: tuple[list[Piece], list[Piece]] = ([], [])
    for side, pieces in enumerate((train, test)):
        for piece in pieces:
            key = bool(side), file.entries[piece.segment].flight
            if sum(map(len, heads[side])) >= MOST_HELD or seen.get(key, 0) >= COPY_HEAD:
                continue
            part = replace(piece, stop=min(piece.stop, piece.start + COPY_HEAD - seen.get(key, 0)))
            seen[key] = seen.get(key, 0) + len(part)
            heads[side].append(part)
    known, held = (FilePart(file, tuple(part)).read() for part in heads)
    found = find_copy(known.segments, held.segments, file.dt_s)
    if found is not None:
        raise DataError(
            f"held-out flight {found.held_out!r} repeats training flight {found.training!r}: {found.how}",
            hint="remove one of the two logs",
        )
