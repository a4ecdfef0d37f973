"""Small models whose truth is known, for tests of what is built on top of models."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.model.base import Rule
from flysid.model.frequency.response import MeasuredResponse


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """y(k) = a y(k-1) + b u(k-1) + c + d tanh(y(k-1)); keeps the laws of `flysid.model.base`."""

    a: float = 0.9
    b: float = 0.1
    c: float = 0.0
    d: float = 0.0
    structure: str = "arx"
    dt_s: float = 0.05
    inputs: tuple[Signal, ...] = (Signal("u", "deg"),)
    outputs: tuple[Signal, ...] = (Signal("y", "m/s"),)
    n_init: int = 1
    n_parameters: int = 3
    limit: float = 1e3
    notes: tuple[str, ...] = ("made by hand",)
    labels: tuple[str, ...] = field(default=("R1",))

    @property
    def output_limits(self) -> FloatArray:
        return np.array([[-self.limit], [self.limit]])

    def step(self, y: FloatArray, u: FloatArray) -> FloatArray:
        value = self.a * y + self.b * u + self.c
        if self.d:
            value = value + self.d * np.tanh(y)
        return np.minimum(np.maximum(value, -self.limit), self.limit)

    def simulate(self, u: FloatArray, y0: FloatArray | None = None) -> FloatArray:
        y = np.zeros((len(u), 1))
        if y0 is not None:
            y[: self.n_init] = y0[: self.n_init]
        if not self.d and np.isfinite(u).all() and np.isfinite(y[: self.n_init]).all():
            return self._quickly(u, y)
        for k in range(self.n_init, len(u)):
            y[k] = self.step(y[k - 1], u[k - 1])
        return y

    def _quickly(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """As `step` by `step`, in Python's own numbers, which take a small part of the time."""
        a = self.a
        c = self.c
        limit = self.limit
        value = float(y[self.n_init - 1, 0])
        values = []
        for driven in (self.b * u[self.n_init - 1 : -1, 0]).tolist():
            value = a * value + driven + c
            if value > limit:
                value = limit
            elif value < -limit:
                value = -limit
            values.append(value)
        y[self.n_init :, 0] = values
        return y

    def predict(self, u: FloatArray, y: FloatArray, k: int = 1) -> FloatArray:
        out = np.full_like(y, np.nan)
        first = self.n_init + k - 1
        value = y[first - k : len(y) - k]
        for back in range(k, 0, -1):
            value = self.step(value, u[first - back : len(u) - back])
        out[first:] = value
        return out

    def rules(self) -> tuple[Rule, ...]:
        gain = np.array([[self.b / (1.0 - self.a) if self.a != 1.0 else np.nan]])
        tau = -self.dt_s / np.log(self.a) if 0.0 < self.a < 1.0 else np.inf
        return tuple(
            Rule(
                label=label,
                condition="always" if len(self.labels) == 1 else f"y(k-1) is A{i + 1}",
                conclusion=f"y(k) = {self.a:.4g} y(k-1) + {self.b:.4g} u(k-1)",
                dc_gain=gain,
                time_constant_s=float(tau),
                pole_radius=abs(self.a),
                support=1.0 / len(self.labels),
            )
            for i, label in enumerate(self.labels)
        )

    def firing(self, u: FloatArray, y: FloatArray) -> FloatArray:  # noqa: ARG002
        centres = np.linspace(-1.0, 1.0, len(self.labels))
        weights = np.exp(-((np.clip(y[:, :1], -5.0, 5.0) - centres) ** 2))
        normalised: FloatArray = weights / weights.sum(axis=1, keepdims=True)
        return normalised

    @property
    def antecedents(self) -> tuple[str, ...]:
        return (f"{self.outputs[0].name}(k-1)",)

    def memberships(self, variable: int, x: FloatArray) -> FloatArray:
        assert variable == 0
        centres = np.linspace(-1.0, 1.0, len(self.labels))
        grades: FloatArray = np.exp(-((x[:, None] - centres) ** 2))
        return grades

    def rule_outputs(self, u: FloatArray, y: FloatArray) -> FloatArray:
        one = self.predict(u, y, 1)
        return np.stack([one + 0.1 * r for r in range(len(self.labels))], axis=1)

    def to_dict(self) -> dict[str, Any]:
        return {"structure": self.structure, "a": self.a, "b": self.b, "c": self.c}

    def save(self, path: str | Path) -> None:
        Path(path).write_text(json.dumps(self.to_dict()), "utf-8")


def fields_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """Names of a JSON document in depth, with what kind of value stands there, as far as null tells."""
    return {
        name: fields_of(value) if isinstance(value, Mapping) else isinstance(value, list)
        for name, value in document.items()
    }


def flat_response(count: int) -> MeasuredResponse:
    """1 from two inputs to one output, measured without error at `count` points an octave apart."""
    one = np.ones((count, 2))
    return MeasuredResponse(
        omega=np.exp2(np.arange(float(count))),
        response=one.astype(np.complex128),
        coherence=one,
        error=0.0 * one,
        averages=one,
        freedom=np.ones(count),
        correlation=np.repeat(np.eye(count)[None], 2, axis=0),
        shared=0.0,
        dt_s=0.01,
        inputs=(Signal("u"), Signal("v")),
        output=Signal("y"),
    )


def smooth_input(n: int, rng: np.random.Generator, hold: int = 25) -> FloatArray:
    """(n, 1) steps of random height, held for `hold` samples."""
    heights = rng.normal(size=n // hold + 1)
    return np.repeat(heights, hold)[:n, None]


def flown(truth: FirstOrder, lengths: list[int], noise: float, seed: int = 0, flights: int = 0) -> Dataset:
    """Segments of `truth` with white measurement noise; in `flights` flights (0: each its own)."""
    rng = np.random.default_rng(seed)
    segments = []
    for i, n in enumerate(lengths):
        u = smooth_input(n, rng)
        y = truth.simulate(u, np.zeros((1, 1))) + noise * rng.normal(size=(n, 1))
        name = f"flight-{i % flights if flights else i}"
        segments.append(Segment(u, y, t0_ns=i * 10**10, flight=name))
    return Dataset(truth.dt_s, truth.inputs, truth.outputs, tuple(segments), name="channel")
