"""What a comparison is: scores, pairs, entries per output and horizon."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from flysid.dataset import Dataset, Segment, Signal
from flysid.errors import UsageError
from flysid.model.base import Fitted
from flysid.model.structures import kind_of
from flysid.showing import clock
from flysid.validate.compare.intervals import ErrorChange, Scope
from flysid.validate.compare.metrics import Scores
from flysid.validate.compare.trials import FREE_RUN, horizon_name
from flysid.validate.compare.verdict import Evidence, Verdict

BEGIN = "begin_s"
"""Mark of a segment: vehicle time at which its flight began, in seconds."""
_HASH = re.compile(r"-[0-9a-f]{8}(?=$|#)")


@dataclass(frozen=True)
class SegmentScore:
    """One model on one held-out segment: its index, its flight, its scores."""

    segment: int
    flight: str
    scores: Scores
    diverged_s: float | None


@dataclass(frozen=True)
class ModelScore:
    """One model on one output at one horizon: pooled and per segment."""

    scores: Scores
    segments: tuple[SegmentScore, ...]

    @property
    def diverged(self) -> tuple[SegmentScore, ...]:
        """Segments in which the free run ran into its limits."""
        return tuple(s for s in self.segments if s.diverged_s is not None)

    @property
    def worst_segment(self) -> SegmentScore:
        """That of the largest RMSE."""
        return max(self.segments, key=lambda s: s.scores.rmse)


@dataclass(frozen=True)
class Pair:
    """One model against the baseline on one output at one horizon.

    Attributes
    ----------
    change_pct : 100 (RMSE - RMSE of baseline) / RMSE of baseline, below 0 the model is better: on a typical
        flight (the geometric mean) where the scope is another flight, else of all samples together. None
        where the baseline's error is zero or a model diverged.
    ci95 : its 95 % interval, or None.
    p, p_holm : two-sided p-value of no change, before and after Holm's correction.
    unit : what the interval's units are: "flights" or "blocks of 1.2 s".
    basis : scope, number of units, change of every flight.
    short_of : linear models in the table that the contender is not shown to be better than, although it is
        better than the baseline: validation may have chosen the wrong one, and beating it proves little.
    one_rule : the model is a Takagi-Sugeno model of one rule: a linear model, so whatever it gains over the
        baseline comes from its order or its refinement, not from fuzziness.
    """

    model: str
    baseline: str
    change_pct: float | None
    ci95: tuple[float, float] | None
    p: float | None
    p_holm: float | None
    unit: str
    basis: ErrorChange
    evidence: Evidence
    verdict: Verdict
    reason: str
    one_rule: bool = False
    short_of: tuple[str, ...] = ()

    @property
    def scope(self) -> Scope:
        """What the verdict speaks of."""
        return self.basis.scope

    @property
    def units(self) -> int:
        """How many flights or blocks of time the interval rests on."""
        return self.basis.units

    @property
    def pooled_pct(self) -> float | None:
        """Change of the RMSE of all samples together; long or bad flights count more than others."""
        e = self.evidence
        if self.change_pct is None or e.rmse_baseline <= 0.0:
            return None
        return 100.0 * min(e.rmse_model / e.rmse_baseline - 1.0, 1e300)

    @property
    def contested(self) -> bool:
        """Better than the baseline, and not shown to be better than another linear model."""
        return self.verdict is Verdict.BETTER and not self.one_rule and bool(self.short_of)

    @property
    def earned(self) -> bool:
        """The model is better than every linear one, and not the linear model of one rule."""
        return self.verdict is Verdict.BETTER and not self.one_rule and not self.short_of


@dataclass(frozen=True)
class Entry:
    """One output at one horizon: every model's scores, every pair.

    Attributes
    ----------
    pairs : every model against the baseline.
    rivals : a fuzzy contender against every other linear model, at the headline's horizon.
    """

    output: Signal
    horizon: str
    models: Mapping[str, ModelScore]
    pairs: Mapping[str, Pair]
    resolution: float
    rivals: Mapping[str, Pair] = field(default_factory=dict)


@dataclass(frozen=True)
class ModelInfo:
    """What a reader needs to know of a model."""

    name: str
    structure: str
    n_parameters: int
    n_rules: int
    n_init: int
    notes: tuple[str, ...]

    @property
    def reference(self) -> bool:
        """The mean or persistence: a line to stay below, not a model to choose."""
        return kind_of(self.structure) == "reference"

    @property
    def physical(self) -> bool:
        """Equations of the vehicle, whose numbers have names."""
        return kind_of(self.structure) == "physics"

    @property
    def fuzzy(self) -> bool:
        """A model of rules, be it of a single one."""
        return kind_of(self.structure) == "rules"


@dataclass(frozen=True)
class Comparison:
    """Models compared on the held-out segments of one channel.

    Attributes
    ----------
    channel : name of the dataset.
    models : by name, in the order given.
    baseline, contender : the pair the headline speaks of; contender is None for a single model.
    entries : one per output and horizon.
    lags : measured samples that every model needs at least.
    start_s : the longest window at a segment's start that gave the starting state of a free run; not scored.
    unused_segments : held-out segments too short to score in free run.
    test_hash : content hash of the test part.
    fitted, test : what was compared, for drawing; not part of equality.
    """

    channel: str
    dt_s: float
    models: Mapping[str, ModelInfo]
    baseline: str
    contender: str | None
    entries: tuple[Entry, ...]
    lags: int
    start_s: float
    scored_segments: int
    unused_segments: int
    test_hash: str
    fitted: Mapping[str, Fitted] = field(repr=False, compare=False)
    test: Dataset = field(repr=False, compare=False)

    @property
    def horizons(self) -> tuple[str, ...]:
        """In the order of the table."""
        return tuple(dict.fromkeys(e.horizon for e in self.entries))

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the held-out segments: flight, and time in it."""
        return segment_names(self.test)

    @property
    def head(self) -> str:
        """The horizon the headline speaks of: the free run, the first where there is none."""
        return FREE_RUN if FREE_RUN in self.horizons else self.horizons[0]

    @property
    def verdict(self) -> dict[str, Pair]:
        """The headline pair in free run (or the first horizon), by output name."""
        if self.contender is None:
            return {}
        return {e.output.name: e.pairs[self.contender] for e in self.entries if e.horizon == self.head}

    def entry(self, output: str | None = None, horizon: str | int = FREE_RUN) -> Entry:
        """The entry of an output (the first when None) at a horizon.

        Raises
        ------
        UsageError : there is no such entry.
        """
        name = horizon_name(horizon)
        for e in self.entries:
            if e.horizon == name and output in (None, e.output.name):
                return e
        raise UsageError(f"no output {output!r} at horizon {name!r} in this comparison")


def segment_names(data: Dataset) -> tuple[str, ...]:
    """A name for every segment: its flight, and its time in the flight where the flight has several.

    The hash that ends a flight's id is left out where the rest names one flight only.

    >>> data = Dataset.from_arrays([[0.0] * 4] * 2, [[0.0] * 4] * 2, 0.1)
    >>> segment_names(data)
    ('segment-0', 'segment-1')
    """
    short = {flight: _HASH.sub("", flight) for flight in data.flights}
    taken = Counter(short.values())
    several = Counter(s.flight for s in data.segments)
    names = []
    for i, segment in enumerate(data.segments):
        name = short[segment.flight] if taken[short[segment.flight]] == 1 else segment.flight
        name = name or f"flight {i + 1}"
        names.append(name if several[segment.flight] == 1 else f"{name} {clock(_time_s(segment, data))}")
    repeated = Counter(names)
    return tuple(n if repeated[n] == 1 else f"{n} ({i + 1})" for i, n in enumerate(names))


def _time_s(segment: Segment, data: Dataset) -> float:
    return segment.t0_ns * 1e-9 - begin_s(segment, data)


def begin_s(segment: Segment, data: Dataset) -> float:
    """Vehicle time at which a segment's flight began; its first segment's where the data do not say."""
    begin = segment.marks.get(BEGIN)
    if isinstance(begin, float):
        return begin
    return min(s.t0_ns for s in data.segments if s.flight == segment.flight) * 1e-9
