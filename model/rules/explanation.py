"""Why a TS model gave its output at one moment: which rules spoke, how loudly, and on what ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.base import Rule
from flysid.model.polynomials import ROUNDING
from flysid.model.rules.kernel import firing
from flysid.model.rules.rule_model import RuleModel
from flysid.showing import significant

CAUTION = "Caution:"
"""How a model's note begins that whoever uses the model must know."""


@dataclass(frozen=True)
class Voice:
    """One rule at one moment.

    Attributes
    ----------
    label, condition : as in `Rule`.
    share : its normalised firing strength, 0 to 1.
    output : (n_y,) what it concludes by itself.
    """

    label: str
    condition: str
    share: float
    output: tuple[float, ...]


@dataclass(frozen=True)
class Explanation:
    """One step of a model, taken apart.

    Attributes
    ----------
    row : sample explained.
    antecedents : name -> value that the memberships saw.
    outside : names of antecedents outside the range seen in training; farther out than a quarter of it the
        memberships stay as they are there.
    voices : rules by share, loudest first.
    output : (n_y,) their weighted mean, the prediction.
    cautions : the model's notes on what it must not be used for.
    """

    row: int
    antecedents: dict[str, float]
    outside: tuple[str, ...]
    voices: tuple[Voice, ...]
    output: tuple[float, ...]
    cautions: tuple[str, ...] = ()

    def __str__(self) -> str:
        """In words."""
        seen = ", ".join(f"{name} = {significant(value)}" for name, value in self.antecedents.items())
        lines = [f"At sample {self.row}" + (f", {seen}:" if seen else ":")]
        for voice in self.voices:
            if voice.share >= 0.005:
                says = ", ".join(significant(v) for v in voice.output)
                lines.append(
                    f"  {voice.label} has weight {100 * voice.share:.0f} % ({voice.condition}): {says}"
                )
        lines.append("  together: " + ", ".join(significant(v) for v in self.output))
        lines += [f"  {name} is outside the range seen in training" for name in self.outside]
        lines += [f"  {caution}" for caution in self.cautions]
        return "\n".join(lines)


class Started(Protocol):
    """A model that needs so many samples before the first that it speaks of."""

    @property
    def n_init(self) -> int: ...


class ExplainedModel(Started, Protocol):
    """A model of rules, as far as it is explained alike over lags and over states."""

    @property
    def antecedents(self) -> tuple[str, ...]: ...
    @property
    def trained_range(self) -> FloatArray: ...
    @property
    def notes(self) -> tuple[str, ...]: ...
    def rules(self) -> tuple[Rule, ...]: ...


def explain(model: RuleModel, u: FloatArray, y: FloatArray, row: int) -> Explanation:
    """Take the step to sample `row` apart: outputs as measured, hidden states as the free run has them.

    Raises
    ------
    UsageError : the row has no full history, or is not there.
    """
    refuse_row(model, row, len(y))
    layout = model.layout
    W = model.seen(u[: row + 1], y[: row + 1])
    shares = firing(W, row, layout.lags, model.parameters)[row]
    n_y = layout.n_y
    alone = model.parameters.theta[:, :n_y] @ layout.regressor_values(W)[-1]
    alone = alone * layout.scale[:n_y] + layout.shift[:n_y]
    z = _antecedents(model, W)[-1]
    return taken_apart(model, row, z, (shares, alone), np.clip(shares @ alone, *model.output_limits))


def refuse_row(model: Started, row: int, samples: int) -> None:
    """Raises UsageError where a row of so many samples has no full history, or is not there."""
    if not isinstance(row, int | np.integer) or not model.n_init <= row < samples:
        raise UsageError(
            f"sample {row!r} cannot be explained", hint=f"choose one from {model.n_init} to {samples - 1}"
        )


def taken_apart(
    model: ExplainedModel, row: int, z: FloatArray, said: tuple[FloatArray, FloatArray], output: FloatArray
) -> Explanation:
    """One step in words and numbers.

    Parameters
    ----------
    z : (n_z,) antecedents, physical units.
    said : (R,) firing strengths, and (R, n_y) what every rule concludes alone.
    output : (n_y,) the prediction.
    """
    shares, alone = said
    rules = model.rules()
    beyond = is_outside(model, z[None])[0]
    return Explanation(
        row,
        {name: float(v) for name, v in zip(model.antecedents, z, strict=True)},
        tuple(name for name, out in zip(model.antecedents, beyond, strict=True) if out),
        tuple(
            Voice(rules[r].label, rules[r].condition, float(shares[r]), tuple(float(v) for v in alone[r]))
            for r in np.argsort(-shares, kind="stable")
        ),
        tuple(float(v) for v in output),
        tuple(note for note in model.notes if note.startswith(CAUTION)),
    )


def _antecedents(model: RuleModel, W: FloatArray) -> FloatArray:
    """(N - depth, n_z) antecedent variables along W, physical units."""
    shift, scale = model.layout.antecedent_scaling()
    return np.asarray(model.layout.antecedent_values(W) * scale + shift)


def outside_share(model: RuleModel, u: FloatArray, y: FloatArray) -> float:
    """Share of samples, 0 to 1, in which an antecedent lies outside the range seen in training.

    Outputs are as measured, hidden states as the free run has them.

    Raises
    ------
    UsageError : shapes do not fit.
    """
    z = _antecedents(model, model.seen(u, y))
    return float(is_outside(model, z).any(axis=1).mean()) if z.size else 0.0


def is_outside(model: ExplainedModel, z: FloatArray) -> npt.NDArray[np.bool_]:
    """(N, n_z) which antecedents z (N, n_z) lie outside the range seen in training."""
    low, high = model.trained_range
    rounding = ROUNDING * (high - low)  # the ends are inside
    return np.asarray((z < low - rounding) | (z > high + rounding))
