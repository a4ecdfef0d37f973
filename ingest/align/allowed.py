"""Where a flight may be used: as spans of vehicle time, with remarks about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from flysid.ingest.align import resample
from flysid.ingest.align.resample import Span

CHOOSE_AGAIN = "choose what the log has, or leave out --mode or --between"


@dataclass(frozen=True)
class Allowed:
    """Spans per boot in which all conditions hold; a boot that is not named is not restricted.

    `notes` are remarks for people, `never` says of each condition that never holds what the log has instead.
    """

    spans: Mapping[int, Sequence[Span]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    never: tuple[str, ...] = ()

    def within(self, other: Allowed) -> Allowed:
        """Where both hold."""
        spans = dict(self.spans)
        for boot, own in other.spans.items():
            spans[boot] = resample.intersect(spans[boot], own) if boot in spans else own
        return Allowed(spans, (*self.notes, *other.notes), (*self.never, *other.never))
