"""The paper's static Takagi-Sugeno model: memoryless rules from clusters in the product space.

The paper's section 2 (after Takagi and Sugeno, 1985): clusters of (u, y) are projected to Gaussian
memberships of the inputs, and the consequents are the global least squares of eq. (4)-(5),

    R_r: If u is A_r then y = a_r u + b_r,      P = (X^T X)^-1 X^T Y,   X = [phi_r u, phi_r]

solved by SVD, because neighbouring rules make X nearly collinear. The output is y = sum_r phi_r (a_r u +
b_r), eq. (3). There is no memory: one step ahead and free run are the same thing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import DataError
from flysid.model.arguments import as_columns, as_record, check_inputs, never_changes, no_samples
from flysid.model.base import Rule, write_document
from flysid.model.documents import head_of, signals_of
from flysid.model.last_gates import no_worse_than_held
from flysid.model.rule_tables import Row, if_then, parameters
from flysid.model.rules.clustering import MOST_SAMPLES, Method, cluster, project
from flysid.model.rules.consequents import Consequents, Criterion, check_criterion, fit_consequents
from flysid.model.rules.explanation import Explanation, refuse_row, taken_apart
from flysid.model.rules.memberships import Conjunction, Partition, Shape
from flysid.model.rules.phrases import condition_in_words, equation, in_words
from flysid.model.settings import Settings
from flysid.model.start import FreeRuns
from flysid.model.stream import Source, blocks_of
from flysid.model.threads import on_one_thread
from flysid.showing import counted

_PIECE = 2048  # rows at a time: arrays that large stay in the cache, and cost no new memory


@dataclass(frozen=True)
class StaticTS(Settings):
    """Settings of the paper's static model.

    Parameters
    ----------
    rules : number of clusters, and rules.
    method : "gustafson-kessel", "fuzzy-c-means" or "subtractive".
    shape : of the memberships: "gaussian", "triangle" or "trapezoid".
    conjunction : "product" or "minimum" (differs with several inputs only).
    two_sided : each membership has a left and a right width ("unsymmetrical" in the paper).
    seed : of the clusters' starts.
    consequents : "global", eq. (4); "local": every rule by itself, which can be read by itself; or "mixed",
        see flysid.model.rules.consequents.
    ridge : weight that draws the rules to the one straight line of the data, or "auto": by generalised
        cross-validation.

    Source: Gustafson & Kessel (1979); Takagi & Sugeno (1985), IEEE Trans. SMC 15.

    Examples
    --------
    >>> model = flysid.StaticTS(rules=2).fit(train)  # train: see `flysid.Dataset`
    >>> [rule.label for rule in model.rules()]
    ['R1', 'R2']
    """

    rules: int = 7
    method: Method = "gustafson-kessel"
    shape: Shape = "gaussian"
    conjunction: Conjunction = "product"
    two_sided: bool = True
    seed: int = 0
    consequents: Criterion = "global"
    ridge: float | Literal["auto"] = 0.0

    def check_values(self) -> None:
        """Raise UsageError for no rule, and for a ridge below zero."""
        self.at_least(1, "rules")
        check_criterion(self.consequents, self.ridge)

    @on_one_thread
    @no_worse_than_held
    def fit(self, train: Source, validation: Dataset | None = None) -> FittedStaticTS:
        """Cluster the training samples, then solve eq. (4). `validation` is not needed.

        Data on disk are read in blocks: memory does not grow with them, and the numbers are the same.

        Raises
        ------
        UsageError : fewer than one rule, an unknown method or shape, other settings that cannot be.
        DataError : no samples, an input that never moves, fewer distinct samples than rules, no more samples
            than the rules have numbers.
        """
        del validation
        n_u = len(train.inputs)
        check_inputs(n_u)
        survey = _Survey.of(train)
        partition = self._partition(survey, n_u)
        if survey.rows <= self.rules * (n_u + 1):
            raise DataError(
                f"{counted(self.rules, 'rule')} of {n_u + 1} numbers: more samples are needed than there are "
                f"({survey.rows})",
                hint="ask for fewer rules, or record longer",
            )
        found = fit_consequents(lambda: _pieces(partition, train), self.consequents, self.ridge)
        y_low = survey.low[n_u:]
        y_high = survey.high[n_u:]
        return FittedStaticTS(
            dt_s=train.dt_s,
            inputs=train.inputs,
            outputs=train.outputs,
            partition=partition,
            consequents=found.theta,
            support=_support(partition, train),
            output_limits=np.array([2.0 * y_low - y_high, 2.0 * y_high - y_low]),
            notes=(
                f"{counted(len(partition), 'rule')}, as asked, from {self.method} clusters of inputs and "
                f"outputs in {survey.rows} samples.",
                *self._on_consequents(found),
                "The model has no memory: whatever depends on the past of the input is not in it.",
            ),
        )

    def _on_consequents(self, found: Consequents) -> list[str]:
        if self.consequents == "global" and not found.ridge:
            return []
        return [f"Consequents by {found.told(self.consequents)}."]

    def _partition(self, survey: _Survey, n_u: int) -> Partition:
        clusters = cluster(survey.thinned, self.rules, self.method, seed=self.seed)
        centre, left, right = project(clusters, n_u, two_sided=self.two_sided)
        low = survey.low[:n_u]
        high = survey.high[:n_u]
        return Partition(centre, left, right, low, high, self.shape, self.conjunction)


@dataclass(frozen=True, eq=False, repr=False)
class FittedStaticTS(FreeRuns):
    """A memoryless TS model; see the laws in flysid.model.base.

    Attributes
    ----------
    partition : memberships over the inputs.
    consequents : (R, n_y, n_u + 1) gains a_r and, last, offset b_r.
    support : (R,) share of training samples for which each rule is the strongest.
    """

    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    partition: Partition
    consequents: FloatArray
    support: FloatArray
    output_limits: FloatArray
    notes: tuple[str, ...]

    structure = "static-ts"
    n_init = 0

    @property
    def n_parameters(self) -> int:
        """Consequents, centres and widths."""
        sides = 1 if np.array_equal(self.partition.left, self.partition.right) else 2
        return int(self.consequents.size + (1 + sides) * self.partition.centre.size)

    @property
    def antecedents(self) -> tuple[str, ...]:
        """The inputs, by name."""
        return tuple(f"{s.name}(k)" for s in self.inputs)

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        """(N, n_y) the static map of u; the first k - 1 rows are NaN, as for every model.

        Raises
        ------
        UsageError : shapes do not fit, or k < 1.
        """
        u, y = as_record(self, u, y, k)
        result = self.simulate(u)
        result[: k - 1] = np.nan
        return result

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """(N, n_y) output of eq. (3) for inputs u (N, n_u)."""
        del y0
        u = as_columns(u, len(self.inputs), "u")
        y = np.empty((len(u), len(self.outputs)))
        for begin in range(0, len(u), _PIECE):
            piece = u[begin : begin + _PIECE]
            alone = self.rule_outputs(piece, piece)
            np.einsum("nr,nri->ni", self.firing(piece, piece), alone, out=y[begin : begin + _PIECE])
        return np.asarray(np.clip(np.nan_to_num(y), self.output_limits[0], self.output_limits[1]))

    def rule_outputs(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, R, n_y) what every rule concludes by itself."""
        del y
        u = as_columns(u, len(self.inputs), "u")
        ones = np.ones((len(u), 1))
        return np.asarray(np.einsum("rim,nm->nri", self.consequents, np.hstack([u, ones])))

    def firing(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """(N, R) normalised firing strengths."""
        del y
        return self.partition.firing(as_columns(u, len(self.inputs), "u"))

    def memberships(self, variable: int, x: FloatArray) -> FloatArray:
        """(len(x), R) grade of membership of the values x of one input in every rule's set."""
        return self.partition.grades(variable, x)

    @property
    def trained_range(self) -> FloatArray:
        """(2, n_u) smallest and largest inputs of the training data."""
        return np.stack([self.partition.low, self.partition.high])

    def explain(self, u: FloatArray, y: FloatArray, row: int) -> Explanation:
        """Which rules spoke at a sample, how loudly and why.

        Raises
        ------
        UsageError : shapes do not fit, or the row is not there.
        """
        u, y = as_record(self, u, y)
        refuse_row(self, row, len(u))
        at = u[row : row + 1]
        said = self.firing(at, at)[0], self.rule_outputs(at, at)[0]
        return taken_apart(self, row, at[0], said, self.simulate(at)[0])

    def rules(self) -> tuple[Rule, ...]:
        """Every rule in words."""
        return tuple(self._rule(r) for r in range(len(self.partition)))

    def _rule(self, r: int) -> Rule:
        names = [s.name for s in self.inputs]
        units = [s.unit for s in self.inputs]
        terms = [f"{s.name}(k)" for s in self.inputs]
        text = "; ".join(
            equation(f"{s.name}(k)", self.consequents[r, i, :-1], terms, self.consequents[r, i, -1])
            for i, s in enumerate(self.outputs)
        )
        return Rule(
            label=f"R{r + 1}",
            condition=condition_in_words(self.partition, r, names, units),
            conclusion=text,
            dc_gain=self.consequents[r, :, :-1].copy(),
            time_constant_s=0.0,
            pole_radius=0.0,
            support=float(self.support[r]),
        )

    def __str__(self) -> str:
        """The rules in words."""
        rules = counted(len(self.partition), "rule")
        title = f"Static Takagi-Sugeno model, {rules}, {self.n_parameters} parameters"
        return in_words(title, self.rules(), self.notes, (self.outputs, self.inputs))

    def table(self, output: int = 0) -> tuple[Row, ...]:
        """Rows of the paper's tables for one output: gains, offset, centre of the cluster."""
        theta = self.consequents[:, output]
        centre = self.partition.centre
        return tuple(
            Row(tuple(row[:-1].tolist()), float(row[-1]), tuple(c.tolist()))
            for row, c in zip(theta, centre, strict=True)
        )

    def tables(self) -> str:
        """The rules in the form of the paper's tables 1 to 6: two tables for every output."""
        names = [s.name for s in self.inputs]
        parts = list[str]()
        for i, signal in enumerate(self.outputs):
            rows = self.table(i)
            parts += [f"Fuzzy If-Then rules of {signal.name}", *if_then(rows, names, signal.name), ""]
            parts += [f"Parameters of the membership functions of {signal.name}", *parameters(rows), ""]
        return "\n".join(parts[:-1])

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        return {
            **head_of(self),
            "partition": self.partition.to_dict(),
            "consequents": self.consequents.tolist(),
            "support": self.support.tolist(),
            "output_limits": self.output_limits.tolist(),
            "notes": list(self.notes),
        }

    def save(self, path: str | Path) -> None:
        """Write the model as JSON, whole or not at all."""
        write_document(self.to_dict(), path)


@dataclass(frozen=True, eq=False)
class _Survey:
    """What one pass over the data tells; columns are inputs, then outputs.

    `rows`: samples.
    `low`, `high`: (n_u + n_y,) ranges.
    `thinned`: (at most MOST_SAMPLES, n_u + n_y) evenly spaced samples, the ones that `cluster` would take.
    """

    rows: int
    low: FloatArray
    high: FloatArray
    thinned: FloatArray

    @classmethod
    def of(cls, data: Source) -> _Survey:
        """One pass; DataError where there is nothing to learn from."""
        every = max(1, -(-len(data) // MOST_SAMPLES))
        at = 0
        kept = list[FloatArray]()
        lows = list[FloatArray]()
        highs = list[FloatArray]()
        for u, y in _samples(data):
            piece = np.hstack([u, y])
            kept.append(piece[-at % every :: every].copy())
            lows.append(piece.min(axis=0))
            highs.append(piece.max(axis=0))
            at += len(piece)
        if not at:
            raise no_samples()
        low = np.min(lows, axis=0)
        high = np.max(highs, axis=0)
        for j, signal in enumerate(data.inputs):
            if low[j] == high[j]:
                raise never_changes("input", signal.name)
        return cls(at, low, high, np.vstack(kept))


def _samples(data: Source) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Inputs (n, n_u) and outputs (n, n_y) of all samples, in pieces."""
    n_y = len(data.outputs)
    return ((block[n_y:].T, block[:n_y].T) for _, block in blocks_of(data)())


def _pieces(partition: Partition, data: Source) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Firing strengths (n, R), regressors [u, 1] (n, n_u + 1) and y (n, n_y), in pieces."""
    for u, y in _samples(data):
        yield partition.firing(u), np.hstack([u, np.ones((len(u), 1))]), y


def _support(partition: Partition, data: Source) -> FloatArray:
    """(R,) share of samples for which each rule is the strongest."""
    counts = [
        np.bincount(partition.firing(u).argmax(axis=1), minlength=len(partition)) for u, _ in _samples(data)
    ]
    total = np.sum(counts, axis=0)
    return np.asarray(total / total.sum())


def from_dict(document: Mapping[str, Any]) -> FittedStaticTS:
    return FittedStaticTS(
        dt_s=float(document["dt_s"]),
        inputs=signals_of(document, "inputs"),
        outputs=signals_of(document, "outputs"),
        partition=Partition.from_dict(document["partition"]),
        consequents=np.array(document["consequents"], dtype=np.float64),
        support=np.array(document["support"], dtype=np.float64),
        output_limits=np.array(document["output_limits"], dtype=np.float64),
        notes=tuple(document["notes"]),
    )
