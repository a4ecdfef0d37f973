"""What alignment did, as plain numbers: for `flysid show`, for notes, for a run's record."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

from flysid.ingest.align.doubts import REMARKS, Doubt
from flysid.showing import counted


@dataclass(frozen=True)
class SignalReport:
    """Where a signal of one flight came from and what was left out of it.

    `rate_hz` is the source's own rate, `hold` how it was brought onto the grid.
    """

    name: str
    stream: str
    field: str
    unit: str
    hold: str
    rate_hz: float
    samples: int
    non_finite: int = 0
    duplicates: int = 0
    spikes: int = 0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class FlightReport:
    """What became of one flight.

    `reason`: why it was left out; '' where it was used.
    `segments`, `short_segments`: kept, and dropped because they are shorter than a segment may be.
    `gaps`: how often a pause in a source cut the flight.
    `used_s`, `total_s`: seconds in segments, and seconds in which all sources were there.
    `filtered`: ratio of the anti-alias filter; 1 where none was needed.
    `notes`: conditions that could not be checked, and the like.
    """

    flight: str
    signals: tuple[SignalReport, ...] = ()
    reason: str = ""
    segments: int = 0
    short_segments: int = 0
    gaps: int = 0
    used_s: float = 0.0
    total_s: float = 0.0
    filtered: int = 1
    notes: tuple[str, ...] = ()

    def plus(self, other: FlightReport) -> FlightReport:
        """The counts of another boot added."""
        return replace(
            self,
            segments=self.segments + other.segments,
            short_segments=self.short_segments + other.short_segments,
            gaps=self.gaps + other.gaps,
            used_s=self.used_s + other.used_s,
            total_s=self.total_s + other.total_s,
            filtered=max(self.filtered, other.filtered),
        )


@dataclass(frozen=True)
class AlignReport:
    """What alignment did for one channel, and `doubts`: reasons not to trust a model of it."""

    recipe: str
    channel: str
    rate_hz: float
    flights: tuple[FlightReport, ...]
    doubts: tuple[Doubt, ...] = ()

    @property
    def used_s(self) -> float:
        """Seconds in segments, over all flights."""
        return sum(f.used_s for f in self.flights)

    @property
    def dropped_s(self) -> float:
        """Seconds in which all sources were there, but no segment is."""
        return sum(f.total_s - f.used_s for f in self.flights)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)

    def lines(self) -> list[str]:
        """A few lines for people: the total first, then one per flight."""
        used = sum(1 for f in self.flights if f.segments)
        count = sum(f.segments for f in self.flights)
        first = (
            f"{self.channel}: {counted(count, 'segment')}, {self.used_s:.1f} s at {self.rate_hz:.4g} Hz "
            f"from {used} of {counted(len(self.flights), 'flight')}; {self.dropped_s:.1f} s not used"
        )
        doubts = [f"  {'remark' if d.kind in REMARKS else 'caution'}: {d}" for d in self.doubts]
        return [first, *doubts, *(line for flight in self.flights for line in _flight_lines(flight))]


def _flight_lines(flight: FlightReport) -> list[str]:
    if flight.reason:
        return [f"  {flight.flight}: left out, {flight.reason}"]
    sources = ", ".join(f"{s.name} <- {s.stream}.{s.field} {s.rate_hz:.4g} Hz" for s in flight.signals)
    cut = f"{counted(flight.gaps, 'gap')}, {counted(flight.short_segments, 'short segment')} dropped"
    filtered = f", low-pass for 1:{flight.filtered}" if flight.filtered > 1 else ""
    lines = [f"  {flight.flight}: {counted(flight.segments, 'segment')}, {cut}{filtered}; {sources}"]
    for signal in flight.signals:
        kinds = {
            "samples not finite": signal.non_finite,
            "of equal time": signal.duplicates,
            "that jump": signal.spikes,
        }
        if any(kinds.values()):
            lines.append(
                f"    {signal.name}: dropped " + ", ".join(f"{n} {k}" for k, n in kinds.items() if n)
            )
        lines += [f"    {note}" for note in signal.notes]
    return lines + [f"    {note}" for note in flight.notes]
