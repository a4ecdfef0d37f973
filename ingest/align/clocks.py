"""The clocks of a recipe's other recorders, fitted to the vehicle's clock for one log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from flysid.errors import DataError
from flysid.ingest.align import resample
from flysid.ingest.align.clock_pair import ClockFit, fit_clock
from flysid.ingest.align.recipe import ClockSpec, SignalSpec
from flysid.ingest.align.signals import Loaded, Log, Samples, find_source, load_signal
from flysid.ingest.align.things import find_stream


@dataclass(frozen=True)
class Clocks:
    """Fits per stream and boot, and what to tell about them."""

    fits: Mapping[str, Mapping[int, ClockFit]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def apply(self, loaded: Loaded) -> Loaded:
        """A signal with its times on the vehicle's clock."""
        fits = self.fits.get(loaded.stream)
        if not fits:
            return loaded
        boots = {
            boot: Samples(fits[boot].to_reference(s.t_ns), s.x) if boot in fits else s
            for boot, s in loaded.boots.items()
        }
        return replace(loaded, boots=boots)


def align_clocks(specs: Sequence[ClockSpec], log: Log) -> Clocks:
    """Fit every clock of a recipe whose streams are in the log.

    Raises DataError: the two recordings do not match; the message names the clock.
    """
    fits: dict[str, Mapping[int, ClockFit]] = {}
    notes: list[str] = []
    for spec in specs:
        keys = [key for name in spec.streams if (key := find_stream(name, log.rows)) is not None]
        sources = (spec.other, spec.reference)
        if not keys or any(find_source((source,), log) is None for source in sources):
            continue
        if not spec.enabled:
            notes.append(f"clock of {spec.name}: taken as it is")
            continue
        found = _fit_boots(spec, log)
        fits.update(dict.fromkeys(keys, found))
        notes += [f"clock of {spec.name}: {fit}" for fit in found.values()]
    return Clocks(fits, tuple(notes))


def _fit_boots(spec: ClockSpec, log: Log) -> dict[int, ClockFit]:
    other = load_signal(f"{spec.name} other", SignalSpec(spec.unit, (spec.other,)), log)
    reference = load_signal(f"{spec.name} reference", SignalSpec(spec.unit, (spec.reference,)), log)
    fits: dict[int, ClockFit] = {}
    for boot in sorted(set(other.boots) & set(reference.boots)):
        ours, theirs = (resample.tidy(b.t_ns, b.x) for b in (reference.boots[boot], other.boots[boot]))
        try:
            fits[boot] = fit_clock(ours, theirs, spec.max_offset_s, spec.drift)
        except DataError as error:
            raise DataError(
                f"clock of {spec.name}: {error.message}",
                path=log.name,
                hint=f"{error.hint}; or set enabled = false to take its stamps as they are",
            ) from error
    return fits
