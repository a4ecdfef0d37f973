"""A channel's samples on its grid while its streams come in, as `segments_of` makes them of a whole log.

A grid point is given out once every signal is certain there. The grid's phase, the filter and the pauses that
are bridged are settled where a segment begins, from the samples known by then; a whole log settles them from
all of its samples. Given the same phase the samples are equal to the last bit, derivatives to rounding
(test_gridding.py). Not followed: clocks of other recorders, labels, and a longest segment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import DataError, RecipeError
from flysid.ingest.align import resample
from flysid.ingest.align.conditions import ALWAYS, condition_truths, spans_true
from flysid.ingest.align.grids import command_on_grid, fine_grid, pauses, ratio_of
from flysid.ingest.align.recipe import Condition, Recipe
from flysid.ingest.align.signals import find_source
from flysid.ingest.align.values import names_of
from flysid.live.decoding import Decoder, Rows
from flysid.live.running import KEPT_S, LatestSamples, RunningSignal, RunningSource, values_of

SETTLED_S = 1.0  # of the first output, before periods are believed
SETTLED_ROWS = 10


def streams_of(recipe: Recipe) -> set[str]:
    """The streams that a recipe's signals and conditions may come from."""
    sources = [s for spec in recipe.signals.values() for s in spec.sources]
    sources += [s for condition in recipe.conditions for s in condition.sources]
    headings = [source.yaw for source in sources if source.yaw is not None]
    return {source.stream for source in (*sources, *headings)}


@dataclass(frozen=True, eq=False)
class GridPiece:
    """Samples of a channel, (n, n_u) and (n, n_y), from `t0_ns` on; whether they follow on those before."""

    t0_ns: int
    u: FloatArray
    y: FloatArray
    follows: bool


@dataclass
class _Segment:
    """A segment that is being given out.

    `begin_ns`: of the grid; `done` points of it are out, or were left out at its beginning.
    `ratio`: of the fine grid that is filtered.
    `gaps`, `afters`, `tolerances`: of every signal, ns.
    """

    begin_ns: int
    ratio: int
    gaps: dict[str, float]
    afters: dict[str, float]
    tolerances: dict[str, int]
    done: int = 0
    is_new: bool = True


class _RunningCondition:
    """Where one condition holds: a truth value that counts until the next."""

    def __init__(self, condition: Condition, log: Decoder) -> None:
        found = find_source(condition.sources, log)
        assert found is not None
        self.found = found
        self._source, self.stream = found
        self.condition = condition
        self.tail = LatestSamples()
        self._numbers: RunningSource | None = None
        if condition.above is not None or condition.below is not None:
            self._numbers = RunningSource(self._source, self.stream, condition.unit, log)
        self._column = self._source.fields[0]
        self._log = log

    def take(self, rows: Mapping[str, Sequence[Rows]]) -> None:
        """New rows."""
        if self._numbers is not None:
            t_ns, x = self._numbers.take(rows)
            x = self._source.scale * x + self._source.offset
            finite = np.isfinite(x)
            self._add(t_ns[finite], x[finite], {})
            return
        for part in rows.get(self.stream, ()):
            table = self._log.table(self.stream, self._log.columns(self.stream))
            names = names_of(table, self.stream, self._column, self._log.info)
            self._add(part.t_ns, values_of(part.records, self._column), names)

    def _add(
        self, t_ns: resample.IntArray, values: npt.NDArray[np.generic], names: Mapping[str, str]
    ) -> None:
        times, holds = condition_truths(self.condition, t_ns, values, names)
        later = times > self.tail.t_ns[-1] if len(self.tail) else np.ones(len(times), bool)
        self.tail.add(times[later], holds[later])

    @property
    def spans(self) -> list[resample.Span]:
        """Where it holds; everywhere while an event that sets or clears it has not come."""
        holds = self.tail.x.astype(bool)
        if not (self.condition.set_by or self.condition.cleared_by):
            return spans_true(self.tail.t_ns, holds, 0)
        before = ~holds[:1] if len(holds) else np.ones(1, bool)
        return spans_true(np.append(ALWAYS, self.tail.t_ns), np.append(before, holds), 0)


class RunningGrid:
    """One channel of a recipe on a grid of `dt_s`.

    `recipe`: its conditions' margins are not kept: nobody knows when one will end.
    `log`: decodes the streams.
    """

    def __init__(self, recipe: Recipe, channel: str, dt_s: float, log: Decoder) -> None:
        self._recipe = recipe
        self._spec = recipe.channel(channel)
        self._names = recipe.signals_of(channel)
        self._wanted = [replace(c, margin_s=0.0) for c in recipe.conditions_of(channel)]
        self._dt_ns = round(dt_s * 1e9)
        self._log = log
        self._streams = 0
        self._boot = 0
        self._absent = list(self._names)
        self._fault = ""
        self._forget()

    @property
    def lack(self) -> str:
        """Why no samples are given out, in words; other threads may ask."""
        fault, absent = self._fault, self._absent
        if fault:
            return fault
        if absent:
            sources = self._recipe.signals[absent[0]].sources
            streams = " or ".join(dict.fromkeys(source.stream for source in sources))
            return f"no stream for {absent[0]} has come ({streams})"
        for condition in self._conditions:
            truths = condition.tail.x
            if not len(truths) or not truths[-1]:
                return f"{condition.condition.name} does not hold"
        return "its streams have stopped"

    def _forget(self) -> None:
        self._signals: dict[str, RunningSignal] = {}
        self._conditions: list[_RunningCondition] = []
        self._segment: _Segment | None = None
        self._last_ns = -resample.FOREVER  # of what was given out or left out

    def take(self, rows: Mapping[str, Sequence[Rows]]) -> list[GridPiece]:
        """The samples that new rows make certain.

        Raises RecipeError: a signal cannot be read as the recipe defines it; nothing is given out.
        """
        try:
            given = self._taken(rows)
        except (RecipeError, DataError) as error:
            self._fault = error.advice
            raise
        if given:
            self._fault = ""
        return given

    def _taken(self, rows: Mapping[str, Sequence[Rows]]) -> list[GridPiece]:
        given: list[GridPiece] = []
        boots = sorted({part.boot for parts in rows.values() for part in parts})
        for boot in boots:
            if boot != self._boot:
                self._boot = boot
                self._forget()
                self._streams = 0
            self._resolve()
            if not self._signals:
                continue
            own = {stream: [p for p in parts if p.boot == boot] for stream, parts in rows.items()}
            for signal in self._signals.values():
                signal.take(own)
            for condition in self._conditions:
                condition.take(own)
            given += self._given_out()
        return given

    def _resolve(self) -> None:
        """Find the signals' sources, where streams have come since."""
        if len(self._log.rows) == self._streams:
            return
        self._streams = len(self._log.rows)
        self._fault = ""
        specs = {name: self._recipe.signals[name] for name in self._names}
        found = {name: find_source(spec.sources, self._log) for name, spec in specs.items()}
        self._absent = [name for name, one in found.items() if one is None]
        if self._absent:
            return
        is_other = {name: s.found for name, s in self._signals.items()} != found
        if is_other or any(c.found != find_source(c.condition.sources, self._log) for c in self._conditions):
            self._forget()  # a stream has come that the recipe prefers
            self._signals = {name: RunningSignal(spec, self._log) for name, spec in specs.items()}
        known = {c.condition.name for c in self._conditions}
        for condition in self._wanted:
            if condition.name in known or find_source(condition.sources, self._log) is None:
                continue
            self._conditions.append(_RunningCondition(condition, self._log))
            known.add(condition.name)
        lacking = [c.name for c in self._wanted if c.required and c.name not in known]
        if lacking:
            self._signals = {}
            self._streams = 0
            raise RecipeError(f"condition {lacking[0]!r} has no source yet")

    def _given_out(self) -> list[GridPiece]:
        given: list[GridPiece] = []
        while True:
            if self._segment is None and not self._begin():
                return given
            piece, has_ended = self._go_on()
            if piece is not None:
                given.append(piece)
            if not has_ended:
                return given
            self._segment = None

    def _begin(self) -> bool:
        """Begin a segment at the first span that is not given out yet and long enough to be settled."""
        lead = self._signals[self._spec.outputs[0]].tail
        if len(lead) < 2 or lead.t_ns[-1] - lead.t_ns[0] < SETTLED_S * 1e9:
            return False
        series = {name: signal.tail.series for name, signal in self._signals.items()}
        if not all(len(s.t_ns) for s in series.values()):
            return False
        limits = {
            name: pauses(self._recipe.signals[name], s.period_ns, self._dt_ns) for name, s in series.items()
        }
        gaps = {name: gap for name, (gap, _) in limits.items()}
        afters = {name: after for name, (_, after) in limits.items()}
        for span in self._spans(gaps, afters):
            inside = lead.t_ns[(lead.t_ns >= span[0]) & (lead.t_ns < span[1])]
            if span[1] <= self._last_ns or len(inside) < SETTLED_ROWS:
                continue
            phase = resample.phase_ns(inside, self._dt_ns)
            begin = max(span[0], self._last_ns + 1)
            grid = resample.grid_in((begin, span[1]), self._dt_ns, phase)
            if len(grid) < 2:
                continue
            ratio = ratio_of(self._recipe, series, self._dt_ns)
            fine = grid if ratio == 1 else fine_grid(int(grid[0]), 0, len(grid), self._dt_ns, ratio)
            tolerances = {name: resample.hold_tolerance_ns(s, fine) for name, s in series.items()}
            self._segment = _Segment(int(grid[0]), ratio, gaps, afters, tolerances)
            return True
        return False

    def _spans(self, gaps: Mapping[str, float], afters: Mapping[str, float]) -> list[resample.Span]:
        """Where every signal is known and every condition holds."""
        spans: list[resample.Span] = [(-resample.FOREVER, resample.FOREVER)]
        for name, signal in self._signals.items():
            own = resample.spans_between_gaps(signal.tail.t_ns, gaps[name], afters[name])
            spans = resample.intersect(spans, own)
        for condition in self._conditions:
            spans = resample.intersect(spans, condition.spans)
        return spans

    def _certain_ns(self, segment: _Segment) -> int:
        """No grid point up to here is changed by what is still to come.

        Behind a signal's last sample nothing is: a pause, too, shows by the sample that ends it.
        """
        newest = self._log.newest_ns(self._signals[self._spec.outputs[0]].found[1])
        found = newest - 1 if self._conditions else newest
        for name, signal in self._signals.items():
            last = int(signal.tail.t_ns[-1])
            if signal.spec.hold == "zero":
                tolerance = segment.tolerances[name]
                counts = int(min(segment.afters[name], resample.FOREVER)) - 1
                last = max(last + tolerance, min(newest - 1 - tolerance, last + counts))
                # a mean over a step is known where the step has ended
                is_stamped = tolerance and segment.ratio == 1
                last -= 0 if is_stamped else self._dt_ns
            found = min(found, last)
        return found

    def _go_on(self) -> tuple[GridPiece | None, bool]:
        """The next samples, and whether the segment ends with them."""
        segment = self._segment
        assert segment is not None
        half = resample.TAPS_PER_SIDE if segment.ratio > 1 else 0
        dt = self._dt_ns
        next_ns = segment.begin_ns + (segment.done + half) * dt  # the newest sample that the next one needs
        certain = self._certain_ns(segment)
        if certain < next_ns:
            return None, False
        # a filter of the past reaches back behind what was given out
        at = segment.begin_ns + segment.done * dt
        span = next((s for s in self._spans(segment.gaps, segment.afters) if s[0] <= at < s[1]), (at, at))
        stop_ns = min(certain, span[1] - 1)
        points = (stop_ns - segment.begin_ns) // dt + 1
        piece = self._piece(segment, points) if points - half > segment.done else None
        has_ended = span[1] <= certain
        if has_ended:
            self._last_ns = max(self._last_ns, span[1] - 1)
        return piece, has_ended

    def _piece(self, segment: _Segment, points: int) -> GridPiece | None:
        """The samples up to grid point `points`, less those that the filter does not reach."""
        dt = self._dt_ns
        half = resample.TAPS_PER_SIDE if segment.ratio > 1 else 0
        first = max(segment.done, half)
        if points - half <= first:
            return None
        grid = fine_grid(segment.begin_ns, first - half, points, dt, segment.ratio)
        columns = {name: self._on(name, grid, segment) for name in self._names}
        u = np.stack([columns[name] for name in self._spec.inputs], axis=1)
        y = np.stack([columns[name] for name in self._spec.outputs], axis=1)
        piece = GridPiece(segment.begin_ns + first * dt, u, y, not segment.is_new)
        segment.is_new = False
        segment.done = first + len(u)
        self._last_ns = segment.begin_ns + (segment.done - 1) * dt
        kept = self._last_ns - max(round(KEPT_S * 1e9), 2 * SETTLED_ROWS * dt)
        for tail in [s.tail for s in self._signals.values()] + [c.tail for c in self._conditions]:
            tail.forget(kept)
        return piece

    def _on(self, name: str, grid: resample.IntArray, segment: _Segment) -> FloatArray:
        signal = self._signals[name]
        series = signal.tail.series
        if signal.spec.hold == "linear":
            return resample.decimate(resample.linear(series, grid), segment.ratio)
        return command_on_grid(series, grid, self._dt_ns, segment.ratio, segment.tolerances[name])
