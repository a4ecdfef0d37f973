"""A fitted structured model: named derivatives with intervals, and the sampled system that runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.capabilities import Coefficient
from flysid.model.documents import array_of
from flysid.model.polynomials import Z95, ComplexArray, modes_of
from flysid.model.subspace.fitted_model import FittedStateSpace
from flysid.model.subspace.fitted_model import from_dict as state_space_from
from flysid.showing import counted


@dataclass(frozen=True)
class Derivative:
    """A named term of the model.

    Attributes
    ----------
    value, unit : what was found; 0 where it was dropped.
    error : standard error, from the measured scatter of the responses; printed as the Cramer-Rao bound.
    insensitivity : standard error if all other terms were known.
    dropped : why; "" for a term that was kept.
    """

    name: str
    value: float
    unit: str
    error: float
    insensitivity: float
    dropped: str = ""

    @property
    def interval(self) -> tuple[float, float]:
        """95 %."""
        return self.value - Z95 * self.error, self.value + Z95 * self.error

    def share(self, error: float) -> float:
        """An error in percent of the value."""
        return 100.0 * error / max(abs(self.value), 1e-300)

    def __str__(self) -> str:
        if self.dropped:
            return f"{self.name}: dropped ({self.dropped})"
        return (
            f"{self.name} = {self.value:.4g} +- {Z95 * self.error:.2g} {self.unit}".rstrip()
            + f" (Cramer-Rao {self.share(self.error):.2g} %, "
            + f"insensitivity {self.share(self.insensitivity):.2g} %)"
        )


@dataclass(frozen=True)
class ResponseCost:
    """Tischler's J of a response: below 50 nearly the data, below 100 acceptable."""

    output: str
    input: str
    cost: float
    lowest_rad_s: float
    highest_rad_s: float

    def __str__(self) -> str:
        return (
            f"{self.output} to {self.input}: J {self.cost:.3g} "
            f"from {self.lowest_rad_s:.3g} to {self.highest_rad_s:.3g} rad/s"
        )


@dataclass(frozen=True, eq=False, repr=False)
class FittedStructured(FittedStateSpace):
    """A structured model; the laws of `flysid.model.base` hold.

    What is sampled (A, B, C, D of `realisation`) follows from the continuous system. Predictions model what
    the free run leaves over as an autoregression.

    Attributes
    ----------
    state_names : of the continuous system.
    derivatives : the named terms, in the order of the file; dropped ones have the value 0.
    continuous : "F", "G", "H", "D" and "delay" (1, n_u, seconds), in physical units around the means.
    eigenvalue_errors : (n,) standard errors in the complex plane, rad/s, in the order of `eigenvalues`.
    costs : of every response that was fitted.
    """

    state_names: tuple[str, ...] = ()
    derivatives: tuple[Derivative, ...] = ()
    continuous: Mapping[str, FloatArray] = None  # type: ignore[assignment]
    eigenvalue_errors: FloatArray = None  # type: ignore[assignment]
    costs: tuple[ResponseCost, ...] = ()

    structure = "structured"

    @property
    def eigenvalues(self) -> ComplexArray:
        """(n,) of F, rad/s, slowest first."""
        found = np.asarray(np.linalg.eigvals(self.continuous["F"]), dtype=np.complex128)
        return np.asarray(found[np.argsort(np.abs(found), kind="stable")])

    def coefficients(self) -> list[Coefficient]:
        """Every free term with half the width of its interval."""
        return [
            Coefficient("", "", d.name, d.value, Z95 * d.error) for d in self.derivatives if not d.dropped
        ]

    def derivative(self, name: str) -> Derivative:
        """The term of this name.

        Raises
        ------
        KeyError : there is none.
        """
        return {d.name: d for d in self.derivatives}[name]

    def __str__(self) -> str:
        lines = [
            f"structured state space: {', '.join(self.state_names)}; "
            f"{counted(self.n_parameters, 'free term')}, sample time {self.dt_s:g} s",
            *(f"  {d}" for d in self.derivatives),
            "eigenvalues (rad/s): "
            + "; ".join(
                f"{_number(v)} +- {Z95 * e:.2g}" if np.isfinite(e) else _number(v)
                for v, e in zip(self.eigenvalues, self.eigenvalue_errors, strict=True)
            ),
            *(f"  {c}" for c in self.costs),
        ]
        return "\n".join([*lines, *(f"- {note}" for note in self.notes)])

    def _conclusion(self) -> str:
        words = "; ".join(str(d) for d in self.derivatives if not d.dropped)
        modes = "; ".join(str(m) for m in modes_of(self.poles, self.dt_s))
        return f"{', '.join(s.name for s in self.outputs)}: {words} ({modes})"

    def to_dict(self) -> dict[str, Any]:
        """Everything needed to rebuild the model, as JSON types only."""
        return {
            **super().to_dict(),
            "state_names": list(self.state_names),
            "derivatives": [asdict(d) for d in self.derivatives],
            "continuous": {k: v.tolist() for k, v in self.continuous.items()},
            "eigenvalue_errors": [e if np.isfinite(e) else None for e in self.eigenvalue_errors.tolist()],
            "costs": [asdict(c) for c in self.costs],
        }


def _number(value: complex) -> str:
    return f"{value.real:.4g}" if not value.imag else f"{value.real:.4g}{value.imag:+.4g}j"


def of_state_space(model: FittedStateSpace, **more: Any) -> FittedStructured:
    """A state-space model with what makes it a structured one."""
    return FittedStructured(**{f.name: getattr(model, f.name) for f in fields(FittedStateSpace)}, **more)


def from_dict(document: Mapping[str, Any]) -> FittedStructured:
    """Rebuild a model from `to_dict()`; damage raises KeyError, TypeError or ValueError."""
    plain = replace(state_space_from(document), free=int(document["free"]))
    states = tuple(str(s) for s in document["state_names"])
    n = len(states)
    n_u = len(plain.inputs)
    n_y = len(plain.outputs)
    shapes = {"F": (n, n), "G": (n, n_u), "H": (n_y, n), "D": (n_y, n_u), "delay": (1, n_u)}
    errors = [np.nan if e is None else float(e) for e in document["eigenvalue_errors"]]
    if len(errors) != n:
        raise ValueError("eigenvalue_errors do not fit the states")
    return of_state_space(
        plain,
        state_names=states,
        derivatives=tuple(Derivative(**d) for d in document["derivatives"]),
        continuous={k: array_of(document["continuous"], k, *shape) for k, shape in shapes.items()},
        eigenvalue_errors=np.array(errors),
        costs=tuple(ResponseCost(**c) for c in document["costs"]),
    )
