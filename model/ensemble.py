"""Several models of one kind, each fitted without another part of the data, that speak with their mean.

Where data are few, the one model that validation prefers is chosen by luck; the mean of models fitted to
overlapping parts (Breiman 1996, here with whole blocks of time left out, because neighbouring samples are not
independent) has less variance. How far the members are apart says where the data stop telling.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.errors import DataError, FitError, UsageError
from flysid.model.arguments import as_columns
from flysid.model.base import (
    MODEL_FORMAT,
    MODEL_VERSION,
    Estimator,
    Fitted,
    OperatingPoint,
    Rule,
    write_document,
)
from flysid.model.last_gates import no_worse_than_held
from flysid.model.rules.explanation import Explanation, refuse_row
from flysid.model.rules.phrases import in_words
from flysid.model.settings import Settings
from flysid.model.start import FreeRuns
from flysid.model.structures import all_structures
from flysid.model.threads import on_one_thread
from flysid.model.ts import TS, of_lags


@dataclass(frozen=True)
class Ensemble(Settings):
    """Settings of an ensemble.

    Parameters
    ----------
    of : what every member is.
    members : number of models, each fitted without one of as many blocks of time, at least 2.

    Examples
    --------
    >>> settings = flysid.Ensemble(of=flysid.OE(na=1, nb=1, nk=1), members=3)
    >>> model = settings.fit(train)  # train: see `flysid.Dataset`
    >>> segment = train.segments[0]
    >>> model.spread(segment.u, segment.y[: model.n_init]).shape
    (600, 1)
    """

    of: Estimator = field(default_factory=lambda: TS(states=0))
    members: int = 5

    def check_values(self) -> None:
        """Raise UsageError for fewer than two members."""
        self.at_least(2, "members")

    @on_one_thread
    @no_worse_than_held
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedEnsemble:
        """Fit every member; those that cannot be fitted are left out, and counted.

        Raises
        ------
        UsageError : fewer than two members; no settings of a model.
        DataError : no samples; the data are too short to leave a block out.
        FitError : fewer than two members could be fitted.
        """
        fitted: list[Fitted] = []
        reasons: list[str] = []
        for block in range(self.members):
            try:
                fitted.append(self.of.fit(without_block(train, block, self.members), validation))
            except (FitError, DataError) as error:
                reasons.append(error.message)
        if len(fitted) < 2:
            raise FitError(
                f"{len(fitted)} of {self.members} members could be fitted: {reasons[0]}",
                hint="give more data, or fewer members",
            )
        share = f"{100.0 / self.members:.0f} %"
        notes = [f"The mean of {len(fitted)} models, each fitted without another {share} of the data."]
        if reasons:
            notes.append(f"{len(reasons)} more could not be fitted: {reasons[0]}")
        return FittedEnsemble(tuple(fitted), tuple(notes))


def of_rules(**asked: Any) -> Ensemble:
    """An ensemble of rules over lags; settings as `TS`."""
    return Ensemble(of=of_lags(**asked))


def without_block(data: Dataset, block: int, blocks: int, *, least_rows: int = 30) -> Dataset:
    """The data without one of `blocks` equal stretches of its samples, counted through all segments.

    `least_rows`: of a piece of a segment that is left when a block is taken out.

    Raises DataError: nothing is left.
    """
    total = len(data)
    begin = total * block // blocks
    end = total * (block + 1) // blocks
    kept: list[Segment] = []
    at = 0
    for segment in data.segments:
        n = len(segment)
        first, last = np.clip((begin - at, end - at), 0, n)
        at += n
        if first == last:
            kept.append(segment)
            continue
        for a, b in ((0, int(first)), (int(last), n)):
            if b - a >= least_rows:
                kept.append(segment.slice(a, b, data.dt_s))
    if not kept:
        raise DataError(
            f"{total} samples are too few to leave one of {blocks} blocks out", hint="record longer"
        )
    return data.with_segments(kept)


@dataclass(frozen=True, eq=False, repr=False)
class FittedEnsemble(FreeRuns):
    """Models of the same signals and their mean; see the laws in flysid.model.base.

    Attributes
    ----------
    members : at least two.
    """

    members: tuple[Fitted, ...]
    notes: tuple[str, ...]

    structure = "ensemble"

    @property
    def dt_s(self) -> float:
        """Sample time."""
        return self.members[0].dt_s

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """Input signals."""
        return self.members[0].inputs

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Output signals."""
        return self.members[0].outputs

    @property
    def n_init(self) -> int:
        """Measured samples that start a simulation: as many as the most demanding member needs."""
        return max(m.n_init for m in self.members)

    @property
    def n_parameters(self) -> int:
        """Of all members together."""
        return sum(m.n_parameters for m in self.members)

    @property
    def output_limits(self) -> FloatArray:
        """(2, n_y) lowest and highest output that any member returns."""
        limits = np.stack([m.output_limits for m in self.members])
        return np.stack([limits[:, 0].min(axis=0), limits[:, 1].max(axis=0)])

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        """(N, n_y) mean of the members' predictions; NaN in the first n_init + k - 1 rows."""
        result = np.mean([m.predict(u, y, k) for m in self.members], axis=0)
        result[: self.n_init + k - 1] = np.nan
        return np.asarray(result)

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) mean of the members' free runs, which start from the same measured samples."""
        result = np.asarray(self.runs(u, y0).mean(axis=0))
        if y0 is not None:  # to the last bit, which a mean of equal numbers is not
            n = min(self.n_init, len(result))
            result[:n] = np.asarray(y0, dtype=np.float64).reshape(-1, result.shape[1])[:n]
        return result

    def spread(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) standard deviation of the members' free runs: where the data stop telling."""
        return np.asarray(self.runs(u, y0).std(axis=0))

    def runs(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(M, N, n_y) free run of every member.

        Raises
        ------
        UsageError : shapes do not fit, or fewer than n_init outputs are given.
        """
        u = as_columns(u, len(self.inputs), "u")
        if y0 is None:
            return np.stack([m.simulate(u) for m in self.members])
        n = self.n_init
        start = as_columns(y0, len(self.outputs), "y0")
        if len(start) < n:
            raise UsageError(f"{len(start)} measured samples; the model starts from {n}")
        start = start[:n]
        if len(u) <= n:
            return np.stack([start[: len(u)]] * len(self.members))
        found = []
        for m in self.members:
            first = n - m.n_init
            found.append(np.vstack([start[:first], m.simulate(u[first:], start[first:])]))
        return np.stack(found)

    def rules(self) -> tuple[Rule, ...]:
        """The rules of every member; each member has the same say."""
        share = 1.0 / len(self.members)
        told = [m.rules() for m in self.members]
        counts = [len(rules) for rules in told]
        return tuple(
            replace(
                rule,
                label=f"M{i + 1}.{rule.label}",
                support=rule.support * share,
                here=tuple(_among(point, counts, i) for point in rule.here),
            )
            for i, rules in enumerate(told)
            for rule in rules
        )

    def firing(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, R) normalised firing strengths of all members' rules; rows sum to 1."""
        return np.hstack([m.firing(u, y) for m in self.members]) / len(self.members)

    def explain(self, u: FloatArray, y: FloatArray, row: int) -> Explanation:
        """Which members' rules spoke at a sample, how loudly and why; each member has the same say.

        Raises
        ------
        UsageError : the row has no full history, or is not there; members that have no rules.
        """
        for i, m in enumerate(self.members):
            if not hasattr(m, "explain"):
                raise UsageError(f"member {i + 1} is a {m.structure} model: it has nothing to explain")
        refuse_row(self, row, len(y))
        told: list[Explanation] = [m.explain(u, y, row) for m in self.members]  # type: ignore[attr-defined]
        voices = [
            replace(voice, label=f"M{i + 1}.{voice.label}", share=voice.share / len(told))
            for i, one in enumerate(told)
            for voice in one.voices
        ]
        return Explanation(
            row,
            {name: value for one in told for name, value in one.antecedents.items()},
            tuple(dict.fromkeys(name for one in told for name in one.outside)),
            tuple(sorted(voices, key=lambda voice: -voice.share)),
            tuple(np.mean([one.output for one in told], axis=0).tolist()),
        )

    def __str__(self) -> str:
        """All members' rules."""
        title = f"Ensemble of {len(self.members)} models, {self.n_parameters} parameters"
        return in_words(title, self.rules(), self.notes, (self.outputs, self.inputs))

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        return {
            "format": MODEL_FORMAT,
            "version": MODEL_VERSION,
            "structure": self.structure,
            "members": [m.to_dict() for m in self.members],
            "notes": list(self.notes),
        }

    def save(self, path: str | Path) -> None:
        """Write the model as JSON, whole or not at all."""
        write_document(self.to_dict(), path)


def _among(point: OperatingPoint, counts: Sequence[int], member: int) -> OperatingPoint:
    """A member's operating point among the rules of all: those of the others have no say there."""
    shares = np.full(sum(counts), np.nan)
    first = sum(counts[:member])
    shares[first : first + counts[member]] = point.shares
    return replace(point, shares=shares)


def from_dict(document: Mapping[str, Any]) -> FittedEnsemble:
    members = tuple(all_structures()[str(m["structure"])].from_dict(m) for m in document["members"])
    if len(members) < 2 or any(_signals(m) != _signals(members[0]) for m in members):
        raise ValueError("the members do not fit each other")
    return FittedEnsemble(members, tuple(str(n) for n in document["notes"]))


def _signals(model: Fitted) -> tuple[Any, ...]:
    return model.inputs, model.outputs, model.dt_s
