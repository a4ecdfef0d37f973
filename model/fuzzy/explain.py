"""Why a TS model said what it said at one moment: which rules spoke, how loudly, and on what ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.model.fuzzy.model import FittedTS
from flysid.model.fuzzy.words import number


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
    outside : names of antecedents outside the range seen in training (read as the range's nearest end).
    voices : rules by share, loudest first.
    output : (n_y,) their weighted mean, the prediction.
    """

    row: int
    antecedents: dict[str, float]
    outside: tuple[str, ...]
    voices: tuple[Voice, ...]
    output: tuple[float, ...]

    def __str__(self) -> str:
        """In words."""
        seen = ", ".join(f"{name} = {number(value)}" for name, value in self.antecedents.items())
        lines = [f"At sample {self.row}" + (f", {seen}:" if seen else ":")]
        for voice in self.voices:
            if voice.share >= 0.005:
                says = ", ".join(number(v) for v in voice.output)
                lines.append(
                    f"  {voice.label} spoke with {100 * voice.share:.0f} % ({voice.condition}): {says}"
                )
        lines.append("  together: " + ", ".join(number(v) for v in self.output))
        lines += [f"  {name} is outside the range seen in training" for name in self.outside]
        return "\n".join(lines)


def explain(model: FittedTS, u: FloatArray, y: FloatArray, row: int) -> Explanation:
    """Take the one-step prediction of sample `row` of measured data apart.

    Raises
    ------
    UsageError : the row has no full history, or is not there.
    """
    u, y = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
    if not model.n_init <= row < len(y):
        raise UsageError(
            f"sample {row} cannot be explained", hint=f"choose one from {model.n_init} to {len(y) - 1}"
        )
    begin = row - model.n_init
    part_u, part_y = u[begin : row + 1], y[begin : row + 1]
    shares = model.firing(part_u, part_y)[-1]
    alone = model.rule_outputs(part_u, part_y)[-1]
    z = antecedent_values(model, part_u, part_y)[-1]
    rules = model.rules()
    voices = [
        Voice(rules[r].label, rules[r].condition, float(shares[r]), tuple(float(v) for v in alone[r]))
        for r in np.argsort(-shares, kind="stable")
    ]
    low, high = model.partition.low, model.partition.high
    far = tuple(
        name for name, v, a, b in zip(model.antecedents, z, low, high, strict=True) if not a <= v <= b
    )
    return Explanation(
        row,
        {name: float(v) for name, v in zip(model.antecedents, z, strict=True)},
        far,
        tuple(voices),
        tuple(float(v) for v in model.one_step(part_u, part_y)[-1]),
    )


def antecedent_values(model: FittedTS, u: FloatArray, y: FloatArray) -> FloatArray:
    """(N - n_init, n_z) antecedent variables along measured data, physical units."""
    u = np.asarray(u, dtype=float).reshape(len(u), -1)
    y = np.asarray(y, dtype=float).reshape(len(y), -1)
    shift, scale = model.layout.antecedent_scaling()
    return np.asarray(model.layout.antecedent_values(model.layout.stack(u, y)) * scale + shift)


def outside_share(model: FittedTS, u: FloatArray, y: FloatArray) -> float:
    """Share of samples, 0 to 1, in which an antecedent lies outside the range seen in training."""
    z = antecedent_values(model, u, y)
    return float(model.partition.outside(z).mean()) if len(z) and z.shape[1] else 0.0
