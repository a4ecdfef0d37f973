"""A fitted model as the arithmetic of one step: what every exporter writes out, whatever the structure.

All structures come down to one form, that of `flysid.model.rules.kernel`. Simulated quantities s (the n_y
outputs first, then states) and inputs u stand in normalised units; with regressors w(k), each one of them at
a lag, the constant 1, or worked out of these (`Worked`), and firing strengths phi_r of antecedents z(k),

    s(k) = sum_r phi_r(z(k)) theta_r w(k),        y(k) = scale s(k) + shift, inside the output limits

A linear model is one rule. What a step remembers stands in cells: the constant 1, every input from lag 0 to
its deepest one, every simulated quantity from lag 1 to its deepest one, everything worked out.

Only the modules that make it look inside fitted models. What is written for other programs sees it alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray, Signal
from flysid.model.rules.kernel import Lags

BOUND = 1e30
"""Of a state: far beyond any output's limits, finite in float32."""
Shape = Literal["gaussian", "triangle", "trapezoid"]
Conjunction = Literal["product", "minimum"]
Operation = Literal["change", "magnitude", "sign", "product", "held"]
Place = tuple[int, int]
"""A column and a lag."""


@dataclass(frozen=True, eq=False)
class Memberships:
    """When each of R rules speaks, over n_z antecedents in normalised units.

    Attributes
    ----------
    centre, left, right : (R, n_z) centres, and widths below and above them.
    low, high : (n_z,) antecedents are held inside this range.
    """

    centre: FloatArray
    left: FloatArray
    right: FloatArray
    low: FloatArray
    high: FloatArray
    shape: Shape = "gaussian"
    conjunction: Conjunction = "product"
    NUMBERS: ClassVar[tuple[str, ...]] = ("centre", "left", "right", "low", "high")

    @property
    def two_sided(self) -> bool:
        """Whether any width below a centre differs from that above it."""
        return not np.array_equal(self.left, self.right)

    def weights(self, z: FloatArray) -> FloatArray:
        """(..., R) how loudly each rule speaks at antecedents (..., n_z); every row sums to 1.

        The memberships may have leading axes of their own, which broadcast with those of z.
        """
        gap = np.clip(z, self.low, self.high)[..., None, :] - self.centre
        d = gap / np.where(gap < 0.0, self.left, self.right)
        if self.shape == "gaussian":
            grade = -0.5 * d * d
            grade = grade.min(axis=-1) if self.conjunction == "minimum" else grade.sum(axis=-1)
            phi = np.exp(grade - grade.max(axis=-1, keepdims=True))
        else:
            sides = 1.0 - np.abs(d) / 2.0 if self.shape == "triangle" else (2.0 - np.abs(d)) / 1.5
            sides = np.clip(sides, 0.0, 1.0)
            phi = sides.min(axis=-1) if self.conjunction == "minimum" else sides.prod(axis=-1)
            nearest = np.eye(phi.shape[-1])[np.argmin((d * d).sum(axis=-1), axis=-1)]
            phi = np.where(phi.max(axis=-1, keepdims=True) > 0.0, phi, nearest)  # else no rule fires
        return np.asarray(phi / phi.sum(axis=-1, keepdims=True))


class Worked(NamedTuple):
    """What a step works out of two other values before it looks at regressors.

    That is a - b, |a|, sign(a), a b, or a held between `low` and `high`.
    """

    operation: Operation
    a: Place
    b: Place = (-1, 0)
    low: float = 0.0
    high: float = 0.0


class AffinePast(NamedTuple):
    """The memory as an affine function of the last samples; all normalised.

    `rows`: number of samples.
    `matrix`: (m, rows (n_u + n_y) + 1) over inputs, row by row, the oldest first, then outputs, then 1.
    """

    rows: int
    matrix: FloatArray


class LikelyPast(NamedTuple):
    """The memory from the start that suits the last samples best (`flysid.model.rules.likely_start`).

    What is searched for is z. mean + root z are `moving` rows of all simulated quantities, the oldest first.
    They end where `depth` samples have passed, and the run goes on from there to the last sample:

        weight * sum |y(k) - yhat(k; z)|^2 + |z|^2,     all normalised

    `rows`: number of samples.
    """

    rows: int
    depth: int
    moving: int
    mean: FloatArray
    root: FloatArray
    weight: float


Past = AffinePast | LikelyPast


@dataclass(frozen=True, eq=False)
class Program:
    """One step of a model, and the cells it starts from at rest.

    Attributes
    ----------
    title : what the model is, for people.
    states : (n,) names and units of the simulated quantities, the outputs first.
    lags : regressors and antecedents; columns count simulated quantities first, then inputs, then `worked`.
    theta : (R, n, n_x) consequents.
    memberships : None for one rule.
    limits : (2, n) simulated quantities are held inside.
    shift, scale : (n + n_u,) of simulated quantities and inputs; physical = normalised * scale + shift.
    output_limits : (2, n_y), physical.
    rest : (n + n_u, deepest lag) normalised values before the first sample, column [:, lag - 1]: where all
        inputs and outputs were zero.
    worked : in the order in which they are worked out; their lag is 0.
    find_past : makes `past`, which costs time and is not wanted by all; None where lags are simply measured.
    """

    title: str
    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    states: tuple[Signal, ...]
    lags: Lags
    theta: FloatArray
    memberships: Memberships | None
    limits: FloatArray
    shift: FloatArray
    scale: FloatArray
    output_limits: FloatArray
    rest: FloatArray
    worked: tuple[Worked, ...] = ()
    find_past: Callable[[], Past] | None = None

    @cached_property
    def past(self) -> Past | None:
        """How the memory follows from the last samples; None where it holds nothing but samples."""
        return None if self.find_past is None else self.find_past()

    @property
    def past_rows(self) -> int:
        """Samples from which the memory follows."""
        return max(self.depths, default=0) if self.past is None else self.past.rows

    @property
    def n(self) -> int:
        """Number of simulated quantities."""
        return len(self.states)

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Simulated quantities, then inputs."""
        return (*self.states, *self.inputs)

    @cached_property
    def depths(self) -> tuple[int, ...]:
        """The deepest lag of every column; 0 where only the present value, or none, is asked for."""
        depths = [0] * len(self.signals)
        for column, lag in self.asked():
            depths[column] = max(depths[column], lag)
        return tuple(depths)

    def asked(self) -> Iterator[Place]:
        """Every signal at every lag that a step looks at."""
        lags = self.lags
        pairs = [*zip(lags.column, lags.lag, strict=True), *zip(lags.z_column, lags.z_lag, strict=True)]
        pairs += [(c, lag) for c, lag in zip(lags.z_column, lags.z_minus, strict=True) if lag >= 0]
        pairs += [place for worked in self.worked for place in (worked.a, worked.b)]
        return ((int(c), int(lag)) for c, lag in pairs if 0 <= c < len(self.signals))

    @cached_property
    def newest(self) -> tuple[int, ...]:
        """Of every column, the cell of its newest value: lag 0 of an input, lag 1 of a simulated quantity.

        Inputs come first, behind the constant 1; a column that nothing asks for has no cell of its own.
        """
        places = [0] * len(self.signals)
        at = 1
        for column in (*range(self.n, len(self.signals)), *range(self.n)):
            places[column] = at
            at += self.depths[column] + (column >= self.n)
        return tuple(places)

    @property
    def cells(self) -> int:
        """Number of cells."""
        return 1 + len(self.inputs) + sum(self.depths) + len(self.worked)

    def cell(self, column: int, lag: int) -> int:
        """Where a column's value of `lag` samples ago stands; column -1 is the constant."""
        if column >= len(self.signals):
            return self.cells - len(self.worked) + column - len(self.signals)
        return 0 if column < 0 else self.newest[column] + lag - (column < self.n)

    @cached_property
    def regressors(self) -> npt.NDArray[np.int64]:
        """(n_x,) cells."""
        pairs = zip(self.lags.column, self.lags.lag, strict=True)
        return np.array([self.cell(int(c), int(lag)) for c, lag in pairs], dtype=np.int64)

    @cached_property
    def working(self) -> tuple[tuple[Operation, int, int, int, float, float], ...]:
        """What is worked out: the operation, the cells of the result, of a, and of b, and the limits."""
        first = len(self.signals)
        return tuple(
            (w.operation, self.cell(first + i, 0), self.cell(*w.a), self.cell(*w.b), w.low, w.high)
            for i, w in enumerate(self.worked)
        )

    @cached_property
    def memory(self) -> tuple[tuple[int, int], ...]:
        """(column, lag) of every cell that one step leaves to the next, in the cells' order."""
        columns = (*range(self.n, len(self.signals)), *range(self.n))
        return tuple((c, lag) for c in columns for lag in range(1, self.depths[c] + 1))

    @cached_property
    def start(self) -> FloatArray:
        """(cells,) at rest, normalised."""
        cells = np.zeros(self.cells)
        cells[0] = 1.0
        for column, lag in self.memory:
            cells[self.cell(column, lag)] = self.rest[column, lag - 1]
        return cells

    def started(self, memory: FloatArray) -> FloatArray:
        """(cells,) that hold `memory` (physical units, in the order of `memory`)."""
        cells = self.start.copy()
        for value, (column, lag) in zip(memory, self.memory, strict=True):
            cells[self.cell(column, lag)] = (value - self.shift[column]) / self.scale[column]
        return cells

    def remembered(self, cells: FloatArray) -> FloatArray:
        """What cells hold, in physical units and the order of `memory`."""
        return np.array([cells[self.cell(c, lag)] * self.scale[c] + self.shift[c] for c, lag in self.memory])
