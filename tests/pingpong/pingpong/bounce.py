"""The ball's height follows the jet with one lag: h(k) = a h(k-1) + b jet(k-1) + c, by least squares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import FitError
from flysid.model.base import MODEL_FORMAT, MODEL_VERSION, Rule, write_document


@dataclass(frozen=True)
class Bounce:
    """Settings: the largest |a| that counts as stable; the seed is taken and not needed."""

    largest_pole: float = 0.9999
    seed: int = 0

    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedBounce:  # noqa: ARG002
        """Least squares over all segments. Raises FitError for several signals, or where it is unstable."""
        if len(train.inputs) != 1 or len(train.outputs) != 1:
            raise FitError("a ball has one jet and one height")
        rows = [np.column_stack([s.y[:-1], s.u[:-1], np.ones(len(s) - 1)]) for s in train.segments]
        target = np.concatenate([s.y[1:, 0] for s in train.segments])
        a, b, c = np.linalg.lstsq(np.concatenate(rows), target, rcond=None)[0]
        if abs(a) > self.largest_pole:
            raise FitError(f"the lag is unstable: a = {a:.4g}")
        y = np.concatenate([s.y[:, 0] for s in train.segments])
        reach = float(np.ptp(y))
        limits = float(y.min()) - reach, float(y.max()) + reach
        return FittedBounce(float(a), float(b), float(c), limits, train.dt_s, train.inputs, train.outputs)


@dataclass(frozen=True)
class FittedBounce:
    """A fitted lag; keeps the laws of `flysid.model.base`."""

    a: float
    b: float
    c: float
    limits: tuple[float, float]
    dt_s: float
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    structure: str = "bounce"
    n_init: int = 1
    n_parameters: int = 3
    notes: tuple[str, ...] = ("A ball on a jet, by least squares.",)

    @property
    def output_limits(self) -> FloatArray:
        """(2, 1)."""
        return np.array(self.limits)[:, None]

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        """Free run from the first measured height."""
        out = np.zeros((len(u), 1))
        first = 0.0 if y0 is None else float(y0[0, 0])
        out[:1] = first
        for k in range(1, len(u)):
            value = self.a * out[k - 1, 0] + self.b * u[k - 1, 0] + self.c
            out[k] = min(max(value, self.limits[0]), self.limits[1])
        return out

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        """k steps from the latest height that may be known."""
        out = np.full((len(u), 1), np.nan)
        ahead = y[: max(len(u) - k, 0), 0].copy()
        for step in range(k):
            ahead = self.a * ahead + self.b * u[step : step + len(ahead), 0] + self.c
        out[k:, 0] = ahead
        return out

    def rules(self) -> tuple[Rule, ...]:
        """One, that always holds."""
        text = f"height(k) = {self.a:.4g} height(k-1) + {self.b:.4g} jet(k-1) + {self.c:.4g}"
        lag = -self.dt_s / np.log(self.a) if 0.0 < self.a < 1.0 else float("nan")
        gain = np.array([[self.b / (1.0 - self.a)]])
        return (Rule("R1", "always", text, gain, float(lag), abs(self.a), 1.0),)

    def firing(self, u: FloatArray, y: FloatArray) -> FloatArray:  # noqa: ARG002
        """Of the one rule."""
        return np.ones((len(u), 1))

    def to_dict(self) -> dict[str, Any]:
        """JSON types only."""
        head = {"format": MODEL_FORMAT, "version": MODEL_VERSION, "structure": self.structure}
        signals = {name: [asdict(s) for s in getattr(self, name)] for name in ("inputs", "outputs")}
        numbers = {name: getattr(self, name) for name in ("a", "b", "c", "dt_s")}
        return head | signals | numbers | {"limits": list(self.limits)}

    def save(self, path: str | Path) -> None:
        """Write it as JSON."""
        write_document(self.to_dict(), path)


def from_dict(document: Mapping[str, Any]) -> FittedBounce:
    """Rebuild a model from `to_dict()`."""
    low, high = document["limits"]
    signals = [tuple(Signal(**s) for s in document[name]) for name in ("inputs", "outputs")]
    numbers = [float(document[name]) for name in ("a", "b", "c")]
    return FittedBounce(*numbers, (float(low), float(high)), float(document["dt_s"]), *signals)  # type: ignore[call-arg, arg-type]
