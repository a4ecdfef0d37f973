"""What rules over lags and rules over states tell alike of themselves: read off layout and parameters."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.model.base import OperatingPoint, write_document
from flysid.model.rules.kernel import Parameters
from flysid.model.rules.memberships import Partition
from flysid.model.rules.phrases import push_in_words
from flysid.model.rules.physical import Scaled, physical_consequents, physical_partition
from flysid.model.rules.regressor_layout import Antecedent
from flysid.model.start import FreeRuns


class RuleLayout(Scaled, Protocol):
    """Signals and antecedents of a model of rules."""

    @property
    def inputs(self) -> tuple[Signal, ...]: ...
    @property
    def outputs(self) -> tuple[Signal, ...]: ...
    @property
    def signals(self) -> tuple[Signal, ...]: ...
    @property
    def antecedents(self) -> tuple[Antecedent, ...]: ...
    @property
    def regressor_names(self) -> tuple[str, ...]: ...


class Ruled(FreeRuns):
    """A fitted model of R rules; a frozen dataclass that derives from it has these fields.

    Attributes
    ----------
    layout : signals, antecedents, scaling.
    parameters : consequents and memberships in normalised units.
    operating_points : what the model does where its vehicle rests.
    support : (R,) share of training samples for which each rule is the strongest.
    """

    layout: RuleLayout
    parameters: Parameters
    operating_points: tuple[OperatingPoint, ...]
    support: FloatArray

    def loudest(self, rule: int) -> tuple[OperatingPoint, ...]:
        """For every output the operating point, if any, where a rule is the strongest and its loudest."""
        own = [p for p in self.operating_points if int(p.shares.argmax()) == rule]
        best = {p.output: p for p in sorted(own, key=lambda p: float(p.shares[rule]))}
        return tuple(best.values())

    def push(self, rule: int) -> str:
        """What a rule's constant does, in words; "" where there are several signals, or it does little."""
        if len(self.parameters.theta) < 2 or len(self.outputs) > 1 or len(self.inputs) > 1:
            return ""
        with np.errstate(all="ignore"):
            pushes = np.array([float(c[0] / B.sum()) for _, B, c in self.local_polynomials()])
        return push_in_words(pushes, self.support, rule, self.inputs[0], float(self.layout.scale[-1]))

    def local_polynomials(self) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
        """Per rule (A, B, c): y(k) = sum_j A[j-1] y(k-j) + sum_j B[j] u(k-j) + c, physical units."""
        raise NotImplementedError

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """Input signals."""
        return self.layout.inputs

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Output signals."""
        return self.layout.outputs

    @property
    def n_parameters(self) -> int:
        """Consequents, and centres and widths where there are several rules."""
        p = self.parameters
        return int(p.theta.size + (2 * p.centre.size if len(p.theta) > 1 else 0))

    @property
    def antecedents(self) -> tuple[str, ...]:
        """Names of the antecedent variables."""
        return tuple(a.name(self.layout.signals) for a in self.layout.antecedents)

    @property
    def regressor_names(self) -> tuple[str, ...]:
        """What the consequents multiply; the last is the constant 1."""
        return self.layout.regressor_names

    @cached_property
    def consequents(self) -> FloatArray:
        """(R, n, n_x) consequents in physical units, in the order of `regressor_names`.

        n counts the outputs; the states, outputs first, where there are hidden ones.
        """
        return physical_consequents(self.layout, self.parameters)

    @cached_property
    def partition(self) -> Partition:
        """Memberships in physical units."""
        return physical_partition(self.layout, self.parameters)

    @property
    def trained_range(self) -> FloatArray:
        """(2, n_z) smallest and largest antecedents of the training data, physical units."""
        return np.stack([self.partition.low, self.partition.high])

    @property
    def centres(self) -> FloatArray:
        """(R, n_z) centres of the memberships, physical units."""
        return self.partition.centre

    @property
    def widths(self) -> FloatArray:
        """(R, n_z) widths of the memberships, physical units."""
        return self.partition.left

    def memberships(self, variable: int, x: FloatArray) -> FloatArray:
        """(len(x), R) grade of membership of values x of one antecedent (physical units)."""
        return self.partition.grades(variable, x)

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        raise NotImplementedError

    def save(self, path: str | Path) -> None:
        """Write the model as JSON, whole or not at all."""
        write_document(self.to_dict(), path)
