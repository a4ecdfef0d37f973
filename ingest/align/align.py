"""Flights and a recipe -> Dataset: one clock, units, signs, cut at gaps; with a report of what was done.

For every flight and boot: each signal is loaded from the first source the log holds, put in time order,
cut where its own source pauses, and brought onto a grid whose phase is that of the first output's stamps,
so that sources of equal rate and stamps come through unchanged. Only where all signals (and all
conditions) hold is there a segment; short ones are dropped and counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from flysid.dataset import BEGAN, JITTER, LOWPASS, Dataset, Segment, Signal
from flysid.datasetfile import write_dataset
from flysid.errors import DataError, RecipeError
from flysid.extras import Extra, extra
from flysid.facts.clock import log_clock
from flysid.facts.vehicle import vehicle_of
from flysid.flight import Flight
from flysid.ingest.align import resample
from flysid.ingest.align.allowed import CHOOSE_AGAIN
from flysid.ingest.align.clocks import align_clocks
from flysid.ingest.align.conditions import condition_spans
from flysid.ingest.align.doubts import doubts
from flysid.ingest.align.grids import command_on_grid, fine_grid, pauses, ratio_of
from flysid.ingest.align.labels import Labels, labels_of
from flysid.ingest.align.late import late_rows
from flysid.ingest.align.on_change import held_specs
from flysid.ingest.align.recipe import Recipe, SignalSpec, load_recipe
from flysid.ingest.align.report import AlignReport, FlightReport, SignalReport
from flysid.ingest.align.resample import RecordedSignal, Span
from flysid.ingest.align.signals import FlightLog, Loaded, Log, find_source, load_signal, missing
from flysid.sharing import sharing
from flysid.showing import counted
from flysid.stretch import FloatArray

MIN_SAMPLES = 20
TOO_SLOW = 0.6  # of the grid's rate: a slower source is not resampled onto it


@dataclass(frozen=True)
class Aligned:
    """A dataset and how it came about."""

    dataset: Dataset
    report: AlignReport


def dataset(flights: Iterable[Flight | Log], recipe: Recipe | str | Path, channel: str) -> Dataset:
    """The dataset of one channel; see `align`."""
    return align(flights, recipe, channel).dataset


def align(
    flights: Iterable[Flight | Log],
    recipe: Recipe | str | Path,
    channel: str,
    *,
    may_stand: bool = False,
    doubted: bool = True,
) -> Aligned:
    """Bring the signals of one channel of many flights onto one grid.

    `flights`: flights in memory or stored; those without the channel's streams are left out, and reported.
    `recipe`: a recipe, or the name or path of one.
    `channel`: a channel of the recipe.
    `may_stand`: an input or output that never changes is no reason to refuse the flights.
    `doubted`: reasons to doubt models of the dataset are looked for.
    Raises RecipeError: no such channel; no flight has the streams; a unit is missing. Raises DataError: no
    segment is long enough, or an input or output never changes.
    """
    logs = _logs_of(flights)
    with _signals_kept(logs):
        job, dt_ns = _prepare(logs, recipe, channel)
        parts = [job.align_log(log, dt_ns) for log in logs]
    segments = tuple(s for _, found, _ in parts for s in found)
    report = AlignReport(job.recipe.name, channel, 1e9 / dt_ns, tuple(part for part, _, _ in parts))
    if not segments:
        raise _too_short(report, job.min_samples(dt_ns))
    aligned = Dataset(
        dt_s=dt_ns / 1e9,
        inputs=job.signals_as(job.inputs, [r for _, _, r in parts]),
        outputs=job.signals_as(job.outputs, [r for _, _, r in parts]),
        segments=segments,
        name=channel,
    )
    if not may_stand:
        check_excitation(aligned)
    if not doubted:
        return Aligned(aligned, report)
    found = extra(Extra.DOUBTS, partial(doubts, aligned, job.recipe.channel(channel)), (), channel)
    return Aligned(aligned, replace(report, doubts=found))


def align_to_file(
    path: str | Path, flights: Iterable[Flight | Log], recipe: Recipe | str | Path, channel: str
) -> AlignReport:
    """As `align`, but the segments go to a dataset file, one flight in memory at a time.

    Raises as `align`, except that inputs which never move are written too; and UsageError, WriteError.
    """
    logs = _logs_of(flights)
    job, dt_ns = _prepare(logs, recipe, channel)
    first = next(log for log in logs if job.absent(log) is None)
    steps = {n: load_signal(n, spec, first).resolution for n, spec in job.specs.items()}
    inputs = job.signals_as(job.inputs, [steps])
    outputs = job.signals_as(job.outputs, [steps])
    head = Dataset(dt_ns / 1e9, inputs, outputs, segments=(), name=channel)
    reports: list[FlightReport] = []

    def segments() -> Iterator[Segment]:
        for log in logs:
            report, found, _ = job.align_log(log, dt_ns)
            reports.append(report)
            yield from found

    write_dataset(path, head, segments())
    return AlignReport(job.recipe.name, channel, 1e9 / dt_ns, tuple(reports))


def segments_of(
    log: Flight | Log, recipe: Recipe, channel: str, dt_s: float
) -> tuple[FlightReport, tuple[Segment, ...]]:
    """The segments of one log on a grid of `dt_s`, whether or not anything moves in them.

    Raises RecipeError: no such channel; a unit is missing.
    """
    logs = _logs_of([log])
    with _signals_kept(logs):
        job = _Job(recipe, channel, held_specs(recipe, channel, logs))
        report, segments, _ = job.align_log(logs[0], round(dt_s * 1e9))
    return report, segments


def _logs_of(flights: Iterable[Flight | Log]) -> list[Log]:
    return [FlightLog(f) if isinstance(f, Flight) else f for f in flights]


def _signals_kept(logs: Sequence[Log]) -> AbstractContextManager[None]:
    """A scope in which one log's signals are loaded once; of several, one at a time is in memory."""
    return sharing() if len(logs) == 1 else nullcontext()


def _prepare(logs: Sequence[Log], recipe: Recipe | str | Path, channel: str) -> tuple[_Job, int]:
    """The job and the sample time in ns."""
    recipe = recipe if isinstance(recipe, Recipe) else load_recipe(recipe)
    job = _Job(recipe, channel, held_specs(recipe, channel, logs))
    usable = [log for log in logs if job.absent(log) is None]
    if not usable:
        raise job.nothing_found(logs)
    return job, job.sample_time_ns(usable)


def check_excitation(data: Dataset) -> None:
    """Refuse a dataset in which an input or output never moves by more than its own resolution.

    Raises DataError: names the signal.
    """
    for kind, signals in (("u", data.inputs), ("y", data.outputs)):
        for i, signal in enumerate(signals):
            low = min(float(getattr(s, kind)[:, i].min()) for s in data.segments)
            high = max(float(getattr(s, kind)[:, i].max()) for s in data.segments)
            if high - low <= max(signal.resolution, 1e-12 * max(abs(low), abs(high))):
                stays = f"{signal.name!r} stays at {low:.6g} {signal.unit}".rstrip()
                count = len(data.segments)
                raise DataError(
                    f"channel {data.name!r}: no excitation: {'input' if kind == 'u' else 'output'} {stays}"
                    + (f" in all {count} segments" if count > 1 else ""),
                    hint="fly steps, doublets or a sweep on this axis, or choose another channel",
                )


@dataclass(frozen=True)
class _Job:
    """A recipe's channel, and what it asks of every log."""

    recipe: Recipe
    channel: str
    specs: Mapping[str, SignalSpec]

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.recipe.channel(self.channel).inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.recipe.channel(self.channel).outputs

    def absent(self, log: Log) -> str | None:
        """The first signal that the log has no source for."""
        return next((n for n, s in self.specs.items() if find_source(s.sources, log) is None), None)

    def nothing_found(self, logs: Sequence[Log]) -> RecipeError:
        if not logs:
            return RecipeError("there are no flights", hint="flysid ingest LOG... -o DATA")
        name = self.absent(logs[0]) or next(iter(self.specs))
        error = missing(name, self.specs[name].sources, logs)
        return RecipeError(
            f"channel {self.channel!r} of recipe {self.recipe.name!r}: {error.message}", hint=error.hint
        )

    def min_samples(self, dt_ns: int) -> int:
        seconds = self.recipe.min_segment_s
        return MIN_SAMPLES if seconds is None else max(2, round(seconds * 1e9 / dt_ns))

    def sample_time_ns(self, logs: Sequence[Log]) -> int:
        """The recipe's sample time, or that of the slowest source: the median over flights, in ns."""
        if self.recipe.rate_hz != "auto":
            return round(1e9 / self.recipe.rate_hz)
        periods = [p for log in logs if np.isfinite(p := self._slowest_period_ns(log))]
        if not periods:
            raise DataError(
                f"channel {self.channel!r}: no flight has two samples of {self._shortest(logs[0])}",
                hint="log longer, or choose another recipe",
            )
        return resample.nice_period_ns(max(float(np.median(periods)), 1e9 / self.recipe.max_rate_hz))

    def _slowest_period_ns(self, log: Log) -> float:
        paced = [n for n, s in self.specs.items() if s.max_gap_s != float("inf")] or list(self.specs)
        return max(_period(load_signal(name, self.specs[name], log)) for name in paced)

    def _shortest(self, log: Log) -> str:
        """The signal with the longest period, and where it stands."""
        found = {n: load_signal(n, spec, log) for n, spec in self.specs.items()}
        name = max(found, key=lambda n: _period(found[n]))
        place = f"{found[name].stream}.{found[name].field}"
        return f"{name!r} ({place}{'; '.join(['', *found[name].notes]) if not found[name].boots else ''})"

    def align_log(
        self, log: Log, dt_ns: int
    ) -> tuple[FlightReport, tuple[Segment, ...], Mapping[str, float]]:
        """Report, segments, and resolution of every signal of one log."""
        lacking = self.absent(log)
        if lacking is not None:
            return FlightReport(log.name, reason=f"no source for {lacking}"), (), {}
        clocks = align_clocks(self.recipe.clocks, log)
        loaded = {n: clocks.apply(load_signal(n, spec, log)) for n, spec in self.specs.items()}
        tidied = {n: self._tidy(n, found) for n, found in loaded.items()}
        reports = tuple(self._describe(n, found, tidied[n]) for n, found in loaded.items())
        empty = [note for found in loaded.values() if not found.boots for note in found.notes]
        reason = "; ".join(empty) or self._too_slow(loaded, dt_ns)
        if reason:
            return FlightReport(log.name, signals=reports, reason=reason), (), {}
        several = len(set.union(*(set(found.boots) for found in loaded.values()))) > 1
        boots = sorted(set.intersection(*(set(found.boots) for found in loaded.values())))
        conditions = condition_spans(self.recipe.conditions_of(self.channel), log)
        if log.allowed is not None:
            conditions = conditions.within(log.allowed)
        labels = labels_of(self.recipe.labels, log)
        report = FlightReport(
            log.name, signals=reports, notes=(*clocks.notes, *conditions.notes, *conditions.never)
        )
        segments: list[Segment] = []
        late = {n: late_rows(log, found.stream) for n, found in loaded.items()}
        begins = log_clock(log.clocks).begins_ns
        dates = {c.boot: c.began_utc_ns for c in log.clocks}
        for boot in boots:
            name = f"{log.name}#{boot}" if several else log.name
            series = {n: boots_of[boot] for n, boots_of in tidied.items()}
            if all(len(s.t_ns) for s in series.values()):
                begin_ns = begins.get(boot, min(int(s.t_ns[0]) for s in series.values()))
                own = labels.get(boot, Labels())
                vehicle = vehicle_of(log.info)
                part = _Boot(self, name, series, dt_ns, own, begin_ns, late, vehicle, dates.get(boot))
                found, counts = part.segments(conditions.spans.get(boot))
                segments += found
                report = report.plus(counts)
        return report, tuple(segments), {n: f.resolution for n, f in loaded.items()}

    def _tidy(self, name: str, found: Loaded) -> dict[int, RecordedSignal]:
        """The boots of a signal, fit for resampling."""
        rate = self.specs[name].max_rate
        return {boot: resample.tidy(s.t_ns, s.x, rate) for boot, s in found.boots.items()}

    def _describe(self, name: str, found: Loaded, boots: Mapping[int, RecordedSignal]) -> SignalReport:
        series = boots.values()
        return SignalReport(
            name=name,
            stream=found.stream,
            field=found.field,
            unit=self.specs[name].unit,
            hold=self.specs[name].hold,
            rate_hz=1e9 / _period(found),
            samples=sum(len(s.t_ns) for s in series),
            non_finite=sum(s.non_finite for s in series),
            duplicates=sum(s.duplicates for s in series),
            spikes=sum(s.spikes for s in series),
            notes=found.notes,
        )

    def _too_slow(self, loaded: Mapping[str, Loaded], dt_ns: int) -> str:
        for name, found in loaded.items():
            rate = 1e9 / _period(found)
            if self.specs[name].max_gap_s != float("inf") and rate < TOO_SLOW * 1e9 / dt_ns:
                return f"{found.stream} has {rate:.3g} Hz, too slow for a grid of {1e9 / dt_ns:.4g} Hz"
        return ""

    def signals_as(
        self, names: Sequence[str], resolutions: Sequence[Mapping[str, float]]
    ) -> tuple[Signal, ...]:
        return tuple(
            Signal(n, self.specs[n].unit, max((r[n] for r in resolutions if n in r), default=0.0))
            for n in names
        )


@dataclass(frozen=True)
class _Boot:
    """The signals of one boot, ready for resampling."""

    job: _Job
    name: str
    series: Mapping[str, RecordedSignal]
    dt_ns: int
    labels: Labels
    begin_ns: int
    late: Mapping[str, resample.IntArray]
    vehicle: str = ""
    began_utc_ns: float | None = None

    def segments(self, allowed: Sequence[Span] | None) -> tuple[list[Segment], FlightReport]:
        """Segments, and the counts of what was kept and dropped. `allowed`: where conditions hold."""
        known = self._spans()
        spans: Sequence[Span] = known
        total = sum(b - a for a, b in known)
        if allowed is not None:
            spans = resample.intersect(spans, allowed)
        spans = resample.cut_long(self.labels.cut(spans), self.job.recipe.max_segment_s)
        ratio = self._ratio()
        made = [self._segment(span, ratio) for span in spans]
        kept = [s for s in made if s is not None and len(s) >= self.job.min_samples(self.dt_ns)]
        counts = FlightReport(
            self.name,
            segments=len(kept),
            short_segments=len(made) - len(kept),
            gaps=max(0, len(known) - 1),
            used_s=sum(len(s) - 1 for s in kept) * self.dt_ns * 1e-9,
            total_s=total * 1e-9,
            filtered=ratio,
        )
        return kept, counts

    def _spans(self) -> list[Span]:
        """Where every signal is known, gaps cut out."""
        spans: list[Span] | None = None
        for name, series in self.series.items():
            own = self._spans_of(name, series)
            spans = own if spans is None else resample.intersect(spans, own)
        return spans or []

    def _spans_of(self, name: str, series: RecordedSignal) -> list[Span]:
        gap, after = pauses(self.job.specs[name], series.period_ns, self.dt_ns)
        return resample.spans_between_gaps(series.t_ns, gap, after, self.late[name])

    def _ratio(self) -> int:
        return ratio_of(self.job.recipe, self.series, self.dt_ns)

    def _segment(self, span: Span, ratio: int) -> Segment | None:
        lead = self.series[self.job.outputs[0]].t_ns
        inside = lead[(lead >= span[0]) & (lead < span[1])]
        if len(inside) == 0:
            return None
        coarse = resample.grid_in(span, self.dt_ns, resample.phase_ns(inside, self.dt_ns))
        if len(coarse) < 2:
            return None
        grid = coarse if ratio == 1 else fine_grid(int(coarse[0]), 0, len(coarse), self.dt_ns, ratio)
        columns = {n: self._on(n, grid, ratio) for n in self.series}
        u = np.stack([columns[n] for n in self.job.inputs], axis=1)
        y = np.stack([columns[n] for n in self.job.outputs], axis=1)
        trimmed = (len(coarse) - len(u)) // 2
        if len(u) == 0 or not (np.isfinite(u).all() and np.isfinite(y).all()):
            return None
        marks = {**self._marks(u), **self.labels.marks(span)}
        marks |= {LOWPASS: float(ratio)} if ratio > 1 else {}
        marks |= {"vehicle": self.vehicle} if self.vehicle else {}
        marks |= {BEGAN: self.began_utc_ns * 1e-9} if self.began_utc_ns is not None else {}
        return Segment(u, y, t0_ns=int(coarse[trimmed]), flight=self.name, marks=marks)

    def _marks(self, u: FloatArray) -> dict[str, str | float]:
        """Duration, excitation, and the share of samples in which an input stands at a limit."""
        stamps = [self.series[n].t_ns for n in self.job.inputs]
        marks: dict[str, str | float] = {
            JITTER: max(map(resample.jitter_ns, stamps), default=0.0) * 1e-9,
            "begin_s": self.begin_ns * 1e-9,
            "duration_s": len(u) * self.dt_ns * 1e-9,
            "excitation": float(u.std(axis=0).max()),
        }
        limits = [self.job.specs[name].limits for name in self.job.inputs]
        at_limit = [
            (x <= lim[0]) | (x >= lim[1]) for x, lim in zip(u.T, limits, strict=True) if lim is not None
        ]
        if at_limit:
            marks["saturated"] = float(np.any(at_limit, axis=0).mean())
        return marks

    def _on(self, name: str, grid: resample.IntArray, ratio: int) -> FloatArray:
        series = self.series[name]
        if self.job.specs[name].hold == "linear":
            return resample.decimate(resample.linear(series, grid), ratio)
        return command_on_grid(series, grid, self.dt_ns, ratio, resample.hold_tolerance_ns(series, grid))


def _period(found: Loaded) -> float:
    """Shortest of the boots' sample times, ns: a boot of two samples must not decide; nor rows without a
    number, as merged tables have."""
    known = [(boot.t_ns, np.isfinite(boot.x)) for boot in found.boots.values()]
    times = [t_ns[finite] if finite.any() else t_ns for t_ns, finite in known]
    longest = max(times, key=len, default=None)
    return float("inf") if longest is None else resample.period_ns(longest)


def _too_short(report: AlignReport, min_samples: int) -> DataError:
    never = dict.fromkeys(note for f in report.flights for note in f.notes if "never holds" in note)
    if never and all(f.reason or not f.total_s or not f.short_segments for f in report.flights):
        return DataError(
            f"channel {report.channel!r}: {'; '.join(never)}",
            hint="choose flights that meet it, or remove the condition from a recipe of your own"
            if any(note.startswith("condition ") for note in never)
            else CHOOSE_AGAIN,
        )
    lost = Counter[str]()
    for signal in (s for f in report.flights for s in f.signals):
        lost[signal.name] += signal.non_finite
    not_finite = [f"{counted(count, 'sample')} of {name} not finite" for name, count in lost.items() if count]
    why = [*(f.reason for f in report.flights if f.reason), *never, *not_finite]
    reasons = "; ".join(dict.fromkeys(why))
    short = sum(f.short_segments for f in report.flights)
    dropped = f"; {short} shorter {'one was' if short == 1 else 'ones were'} dropped" if short else ""
    return DataError(
        f"channel {report.channel!r}: no segment of {min_samples} samples at {report.rate_hz:.4g} Hz"
        f"{dropped}" + (f" ({reasons})" if reasons else ""),
        hint=f"choose a source of {' and '.join(n for n, count in lost.items() if count)} that holds numbers"
        if not_finite and not short
        else "fly longer without pauses in the log, or lower min_segment_s in a recipe of your own",
    )
