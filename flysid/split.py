"""Training and held-out parts that do not leak: by flight, or by time block with a guard; never by sample.

A Split names pieces of segments, with its seed and the hashes of what it was made from and of what it
gives, so that the same held-out part can be made again, and a changed dataset is noticed. Copies of a
training flight among the held-out ones are found by content and refused.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, Protocol, Self, TypeVar

import numpy as np
import numpy.typing as npt

from flysid.errors import DataError, StoreError, UsageError
from flysid.leakage.copies import find_copy
from flysid.showing import counted, significant
from flysid.stretch import FloatArray, Stretch

By = Literal["auto", "flight", "time"]

MIN_FLIGHTS = 3  # from here on "auto" splits by flight
BLOCKS = 10  # per flight, when splitting by time
MIN_PIECE = 20  # samples; shorter pieces are left out


class Splittable(Protocol):
    """What a split needs of a dataset."""

    @property
    def dt_s(self) -> float: ...
    @property
    def segments(self) -> tuple[Any, ...]: ...
    def with_segments(self, segments: Sequence[Any]) -> Self: ...
    def content_hash(self) -> str: ...
    def __len__(self) -> int: ...


D = TypeVar("D", bound=Splittable)


@dataclass(frozen=True)
class Piece:
    """Samples [start, stop) of the segment with index `segment`."""

    segment: int
    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start


@dataclass(frozen=True)
class Split:
    """Which samples train and which are held out.

    Attributes
    ----------
    by : "flight" or "time".
    seed, holdout, guard_s : as given by the caller; the guard applies to "time".
    train, test : pieces of the dataset's segments.
    data_sha256 : hash of the dataset that was split.
    test_sha256 : hash of the held-out part.
    """

    by: str
    seed: int
    holdout: float
    guard_s: float
    train: tuple[Piece, ...]
    test: tuple[Piece, ...]
    data_sha256: str
    test_sha256: str = ""

    def apply(self, data: D) -> tuple[D, D]:
        """(train, test) of the dataset that was split.

        Raises
        ------
        DataError : `data` is not the dataset that was split.
        """
        if data.content_hash() != self.data_sha256:
            raise DataError(
                "the data are not those that were split: their hash differs",
                hint="fit again, or give the folder the models were fitted on",
            )
        return cut(data, self.train), cut(data, self.test)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        document = asdict(self)
        for part in ("train", "test"):
            document[part] = [[p.segment, p.start, p.stop] for p in getattr(self, part)]
        return document

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Split:
        """The split that `to_dict` described; raises StoreError where the document is damaged."""
        try:
            parts = {k: tuple(Piece(*map(int, p)) for p in document[k]) for k in ("train", "test")}
            return cls(
                by=str(document["by"]),
                seed=int(document["seed"]),
                holdout=float(document["holdout"]),
                guard_s=float(document["guard_s"]),
                data_sha256=str(document["data_sha256"]),
                test_sha256=str(document.get("test_sha256", "")),
                **parts,
            )
        except (KeyError, TypeError, ValueError) as error:
            raise StoreError(f"damaged split: {error}", hint="fit again") from error


def default_guard(dt_s: float) -> float:
    """Seconds beside a held-out block that serve neither part: one, or 20 samples where that is longer."""
    return max(1.0, 20 * dt_s)


def resolve_way(by: By, flights: int) -> By:
    """What "auto" stands for with so many flights: "flight" from three on, else "time"."""
    if by != "auto":
        return by
    return "flight" if flights >= MIN_FLIGHTS else "time"


def plan_split(
    data: Splittable,
    *,
    holdout: float = 0.3,
    by: By = "auto",
    seed: int = 0,
    guard_s: float | None = None,
) -> Split:
    """Choose the held-out part.

    `data`: the dataset.
    `holdout`: share of the samples to hold out, in (0, 1).
    `by`: "flight" holds out whole flights, "time" blocks of each flight, about a tenth of it long, with a
        guard on both sides that serves neither part; "auto": by flight from three flights on.
    `seed`: the same seed gives the same split.
    `guard_s`: length of the guard; default one second, or 20 samples where that is longer.
    Raises UsageError: `holdout` or `by` makes no sense. Raises DataError: too few flights or samples; one
    flight is a copy of another, on the other side.
    """
    if not 0 < holdout < 1:
        raise UsageError(f"holdout must lie between 0 and 1, not {holdout}")
    if by not in ("auto", "flight", "time"):
        raise UsageError(f"no way to split by {by!r}", hint="flight or time")
    flights = list(dict.fromkeys(s.flight for s in data.segments))
    way = resolve_way(by, len(flights))
    guard = default_guard(data.dt_s) if guard_s is None else guard_s
    rng = np.random.default_rng(seed)
    if way == "flight":
        train, test = _by_flight(data.segments, flights, holdout, rng)
    else:
        train, test = _by_time(data, flights, holdout, guard, rng)
    if not train or not test:
        samples = sum(len(s.y) for s in data.segments)
        raise DataError(
            f"too little data to hold out {100.0 * holdout:.0f} % by {way}: "
            f"{samples} samples, {significant(samples * data.dt_s)} s, in "
            f"{counted(len(data.segments), 'segment')}",
            hint="add flights, or longer ones",
        )
    refuse_copies(data, train, test)
    return _split_of(data, way, seed, holdout, guard if way == "time" else 0.0, (train, test))


def plan_held(
    data: Splittable,
    held: Mapping[str, Sequence[tuple[int, int]]],
    *,
    seed: int = 0,
    guard_s: float | None = None,
) -> Split:
    """Hold out what is named, instead of a share by chance.

    `data`: the dataset.
    `held`: flight -> spans of vehicle time [start, stop) in ns.
    `guard_s`: samples this near to a held-out span serve neither part; default as `plan_split`.
    Raises DataError: nothing lies in the spans, or nothing beside them; a copy is held out.
    """
    guard = default_guard(data.dt_s) if guard_s is None else guard_s
    rows = [(s.flight, s.t0_ns, len(s.y)) for s in data.segments]
    train, test = held_pieces(rows, data.dt_s, held, guard)
    refuse_copies(data, train, test)
    share = sum(map(len, test)) / len(data)
    way = way_of(rows, train, test)
    return _split_of(data, way, seed, share, guard if way == "time" else 0.0, (train, test))


def held_pieces(
    rows: Sequence[tuple[str, int, int]],
    dt_s: float,
    held: Mapping[str, Sequence[tuple[int, int]]],
    guard_s: float,
) -> tuple[list[Piece], list[Piece]]:
    """(train, test) of segments, each a flight, the time of its first sample in ns, and its samples.

    Raises DataError: nothing lies in the spans, or nothing beside them.
    """
    train: list[Piece] = []
    test: list[Piece] = []
    for index, (flight, t0_ns, count) in enumerate(rows):
        spans_s = [(start * 1e-9, stop * 1e-9) for start, stop in held.get(flight, ())]
        inside, near = _membership(np.asarray(t0_ns * 1e-9 + dt_s * np.arange(count)), spans_s, guard_s)
        test += _runs(index, inside)
        train += _runs(index, ~near)
    if not train or not test:
        raise DataError(
            f"no {MIN_PIECE} samples in a row {'to train on' if test else 'in what is to be held out'}",
            hint="hold out less" if test else "hold out parts that the channel uses, or longer ones",
        )
    return train, test


def way_of(rows: Sequence[tuple[str, int, int]], train: Sequence[Piece], test: Sequence[Piece]) -> By:
    """ "flight" where no flight serves both parts, else "time"."""
    shared = {rows[p.segment][0] for p in train} & {rows[p.segment][0] for p in test}
    return "time" if shared else "flight"


def plan_folds(data: Splittable, folds: int, *, seed: int = 0) -> tuple[Split, ...]:
    """Splits that hold out every flight once: at most `folds`, of about equal numbers of flights.

    Raises DataError: there is one flight only; one flight is a copy of another.
    """
    flights = list(dict.fromkeys(s.flight for s in data.segments))
    if len(flights) < 2:
        raise DataError("one flight cannot be split by flight", hint='by="time", or add flights')
    order = np.random.default_rng(seed).permutation(len(flights))
    found = []
    for some in np.array_split(order, min(folds, len(flights))):
        held = {flights[i] for i in some}
        train, test = _sides(data.segments, held)
        refuse_copies(data, train, test)
        share = sum(map(len, test)) / len(data)
        found.append(_split_of(data, "flight", seed, share, 0.0, (train, test)))
    return tuple(found)


def _split_of(
    data: Splittable,
    by: str,
    seed: int,
    holdout: float,
    guard_s: float,
    sides: tuple[list[Piece], list[Piece]],
) -> Split:
    train, test = sides
    return Split(
        by=by,
        seed=seed,
        holdout=holdout,
        guard_s=guard_s,
        train=tuple(train),
        test=tuple(test),
        data_sha256=data.content_hash(),
        test_sha256=cut(data, test).content_hash(),
    )


def cut(data: D, pieces: Sequence[Piece]) -> D:
    """The dataset that holds only these pieces."""
    return data.with_segments([data.segments[p.segment].slice(p.start, p.stop, data.dt_s) for p in pieces])


def _by_flight(
    segments: Sequence[Stretch], flights: Sequence[str], holdout: float, rng: np.random.Generator
) -> tuple[list[Piece], list[Piece]]:
    """Whole flights, in random order, as long as each brings the held-out share nearer to `holdout`."""
    size = {f: sum(len(s.y) for s in segments if s.flight == f) for f in flights}
    held = flights_to_hold(size, holdout * sum(size.values()), rng)
    return _sides(segments, held)


def _sides(segments: Sequence[Stretch], held: Collection[str]) -> tuple[list[Piece], list[Piece]]:
    whole = [(s.flight in held, Piece(i, 0, len(s.y))) for i, s in enumerate(segments)]
    return [p for is_held, p in whole if not is_held], [p for is_held, p in whole if is_held]


def flights_to_hold(size: Mapping[str, int], goal: float, rng: np.random.Generator) -> set[str]:
    """Flights of together about `goal` samples, but never all.

    `size`: samples of every flight.
    Raises DataError: there is one flight only.
    """
    flights = list(size)
    if len(flights) < 2:
        raise DataError("one flight cannot be split by flight", hint='by="time", or add flights')
    held: set[str] = set()
    held_size = 0
    for i in rng.permutation(len(flights)):
        flight = flights[i]
        better = abs(held_size + size[flight] - goal) < abs(held_size - goal)
        if len(held) < len(flights) - 1 and (better or not held):
            held.add(flight)
            held_size += size[flight]
    return held


def _by_time(
    data: Splittable, flights: Sequence[str], holdout: float, guard_s: float, rng: np.random.Generator
) -> tuple[list[Piece], list[Piece]]:
    """Blocks of the vehicle time of each flight; samples near a held-out block serve neither part."""
    train: list[Piece] = []
    test: list[Piece] = []
    for flight in flights:
        members = [(i, s) for i, s in enumerate(data.segments) if s.flight == flight]
        held = _held_blocks(members, data.dt_s, holdout, rng)
        for index, segment in members:
            times = segment.t0_ns * 1e-9 + data.dt_s * np.arange(len(segment.y))
            inside, near = _membership(times, held, guard_s)
            test += _runs(index, inside)
            train += _runs(index, ~near)
    return train, test


def _held_blocks(
    members: Sequence[tuple[int, Stretch]], dt_s: float, holdout: float, rng: np.random.Generator
) -> list[tuple[float, float]]:
    """Half-open spans of vehicle time, seconds: every block holds the same number of samples."""
    times = np.sort(np.concatenate([s.t0_ns * 1e-9 + dt_s * np.arange(len(s.y)) for _, s in members]))
    count = int(np.clip(len(times) // (2 * MIN_PIECE), 2, BLOCKS))
    edges = [*times[np.linspace(0, len(times), count + 1)[:-1].astype(int)], times[-1] + dt_s]
    held = rng.permutation(count)[: int(np.clip(round(holdout * count), 1, count - 1))]
    return [(float(edges[i]) - dt_s / 2, float(edges[i + 1]) - dt_s / 2) for i in sorted(held)]


def _membership(
    times: FloatArray, held: Sequence[tuple[float, float]], guard_s: float
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Which samples lie in a held-out span, and which in one widened by the guard."""
    inside = np.zeros(len(times), dtype=bool)
    near = np.zeros(len(times), dtype=bool)
    for start, stop in held:
        inside |= (times >= start) & (times < stop)
        near |= (times >= start - guard_s) & (times < stop + guard_s)
    return inside, near


def _runs(segment: int, mask: npt.NDArray[np.bool_]) -> list[Piece]:
    """Runs of true values of at least MIN_PIECE samples."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    pieces = (Piece(segment, int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True))
    return [p for p in pieces if len(p) >= MIN_PIECE]


# ------------------------------------------------------------------------------------------- leakage


def refuse_copies(data: Splittable, train: Sequence[Piece], test: Sequence[Piece]) -> None:
    """Refuse a split that holds out what it trains on: whole copies, or logs that overlap; see `copies`.

    Raises DataError: names the two flights.
    """
    found = find_copy(cut(data, train).segments, cut(data, test).segments, data.dt_s)
    if found is not None:
        raise DataError(
            f"held-out flight {found.held_out!r} repeats training flight {found.training!r}: {found.how}",
            hint="remove one of the two logs",
        )
