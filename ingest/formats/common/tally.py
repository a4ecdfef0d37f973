"""Counting what a reader could not keep, while it reads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

from flysid.flight import Damage, Region

MAX_NAMES = 1000
OTHERS = "(others)"


class Tally:
    """Mutable counterpart of Damage: a reader adds to it and freezes it at the end.

    Byte ranges must be added in rising order; touching ranges of the same reason are joined.
    """

    def __init__(self) -> None:
        self._regions: list[Region] = []
        self._region_count = 0
        self._bytes = 0
        self._undecoded: Counter[str] = Counter()
        self._reasons: dict[str, str] = {}
        self.bad_checksums = 0
        self.truncated = False
        self.repeats = 0  # what a capture saw twice: nothing that was lost
        self.time_outliers: Counter[str] = Counter()
        self.sequence_gaps: Counter[str] = Counter()
        self.dropouts: Counter[str] = Counter()
        self.out_of_order: Counter[str] = Counter()

    def skip(self, start: int, end: int, reason: str) -> None:
        """Bytes [start, end) belong to nothing that could be kept."""
        if end <= start:
            return
        self._bytes += end - start
        last = self._regions[-1] if self._regions else None
        if last is not None and last.end == start and last.reason == reason:
            self._regions[-1] = Region(last.start, end, reason)
            return
        self._region_count += 1
        if len(self._regions) < Damage.MAX_REGIONS:
            self._regions.append(Region(start, end, reason))

    def undecode(self, name: str, count: int = 1, why: str = "") -> None:
        """`count` records of `name` are framed well and cannot be decoded; the first reason is kept."""
        if count and name not in self._undecoded and len(self._undecoded) >= MAX_NAMES:
            name = OTHERS
        if count:
            self._undecoded[name] += count
            if why and name != OTHERS:
                self._reasons.setdefault(name, why)

    def freeze(self) -> Damage:
        """The damage so far."""
        return Damage(
            bytes_skipped=self._bytes,
            regions=tuple(self._regions),
            region_count=self._region_count,
            bad_checksums=self.bad_checksums,
            truncated=self.truncated,
            undecoded=dict(self._undecoded),
            time_outliers=dict(self.time_outliers),
            sequence_gaps=dict(self.sequence_gaps),
            dropouts=dict(self.dropouts),
            out_of_order=dict(self.out_of_order),
            reasons=dict(self._reasons),
        )


def joined(found: Sequence[tuple[int, Damage]]) -> Damage:
    """The damage of files that are one log: of each its bytes and its damage, in order.

    Places count through all files, as if they were one.
    """
    starts = [sum(size for size, _ in found[:k]) for k in range(len(found))]
    every = [damage for _, damage in found]
    regions = [
        replace(region, start=start + region.start, end=start + region.end)
        for start, damage in zip(starts, every, strict=True)
        for region in damage.regions
    ]
    return Damage(
        bytes_skipped=sum(damage.bytes_skipped for damage in every),
        regions=tuple(regions[: Damage.MAX_REGIONS]),
        region_count=sum(damage.region_count for damage in every),
        bad_checksums=sum(damage.bad_checksums for damage in every),
        truncated=any(damage.truncated for damage in every),
        undecoded=_added([damage.undecoded for damage in every]),
        time_outliers=_added([damage.time_outliers for damage in every]),
        sequence_gaps=_added([damage.sequence_gaps for damage in every]),
        dropouts=_added([damage.dropouts for damage in every]),
        out_of_order=_added([damage.out_of_order for damage in every]),
        reasons={name: why for damage in reversed(every) for name, why in damage.reasons.items()},
    )


def _added(counts: Sequence[Mapping[str, int]]) -> dict[str, int]:
    total: Counter[str] = Counter()
    for some in counts:
        total.update(some)
    return dict(total)
