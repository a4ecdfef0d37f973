"""The set of plants that a controller must bear: models, rules, linearisations, ends of intervals, spreads.

A rule is not the vehicle at hover, and a linear model is none of its speeds: so all of them are in the set.
Inside the band of the data a linear model's response is moved to the ends of its 95 % interval; beyond it the
interval at the band's end is kept, since nothing was seen there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.design.law import ComplexArray
from flysid.errors import UsageError
from flysid.model.base import Fitted
from flysid.model.capabilities import LinearModel, LocallyLinear
from flysid.model.polynomials import Z95
from flysid.showing import counted

SPEEDS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles of the output at which a model of rules is linearised."""


@dataclass(frozen=True)
class Spread:
    """What the vehicle may be besides what the flights showed: ends of a range each.

    `gain`: of the plant, as a factor.
    `delay_s`: beside the models' own.
    """

    gain: tuple[float, float] = (1.0, 1.0)
    delay_s: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not (0.0 < self.gain[0] <= 1.0 <= self.gain[1] < 10.0):
            raise UsageError(f"a spread of the gain of {self.gain}", hint="as 0.85..1.15, about 1")
        if not (-1.0 < self.delay_s[0] <= 0.0 <= self.delay_s[1] < 1.0):
            raise UsageError(f"a spread of the delay of {self.delay_s} s", hint="as -0.02..0.04, about 0")


@dataclass(frozen=True, eq=False)
class PlantSet:
    """(P, F) responses at omega (F,), rad/s, each with its label; `dropped` says what was left out."""

    dt_s: float
    omega: FloatArray
    labels: tuple[str, ...]
    responses: ComplexArray
    dropped: tuple[str, ...] = ()

    def spread(self, over: Spread) -> PlantSet:
        """With every plant at the corners of a spread."""
        corners = [
            (gain, late) for gain in sorted({1.0, *over.gain}) for late in sorted({0.0, *over.delay_s})
        ]
        turned = [gain * np.exp(-1j * self.omega * late) for gain, late in corners]
        said = [_corner_text(gain, late) for gain, late in corners]
        return PlantSet(
            self.dt_s,
            self.omega,
            tuple(label + words for words in said for label in self.labels),
            np.concatenate([self.responses * t for t in turned]),
            self.dropped,
        )


def _corner_text(gain: float, late: float) -> str:
    words = [f"gain x {gain:g}"] if gain != 1.0 else []
    words += [f"delay {1000.0 * late:+g} ms"] if late else []
    return ", " + ", ".join(words) if words else ""


def grid(dt_s: float, *, points: int = 160, lowest_rad_s: float = 0.02) -> FloatArray:
    """(F,) rad/s, equally spaced in the logarithm, up to nearly half the sample rate."""
    return np.geomspace(lowest_rad_s, 0.99 * np.pi / dt_s, points)


def plants_of(models: Mapping[str, Fitted], train: Dataset, band: tuple[float, float]) -> PlantSet:
    """All plants that the models of a channel with one input and one output stand for.

    `train`: their training data: where the vehicle was.
    `band`: rad/s, that the data tell.
    Raises UsageError: several inputs or outputs, or no model has a linear picture.
    """
    if len(train.inputs) != 1 or len(train.outputs) != 1:
        raise UsageError(
            f"the channel {train.name!r} has {counted(len(train.inputs), 'input')} and "
            f"{counted(len(train.outputs), 'output')}",
            hint="a loop is designed for one input and one output",
        )
    omega = grid(train.dt_s)
    found: dict[str, ComplexArray] = {}
    dropped = []
    for label, model in models.items():
        for name, response in _pictures(label, model, train, omega, band):
            if response is None:
                dropped.append(f"{name} is unstable by itself")
            else:
                found[name] = response
    if not found:
        raise UsageError(
            f"no model of {train.name!r} is stable",
            hint="fit one: flysid fit DATA --recipe R --models oe -o RUN",
        )
    return PlantSet(train.dt_s, omega, tuple(found), np.array(list(found.values())), tuple(dropped))


Picture = tuple[str, ComplexArray | None]


def _pictures(
    label: str, model: Fitted, train: Dataset, omega: FloatArray, band: tuple[float, float]
) -> Iterator[Picture]:
    if isinstance(model, LocallyLinear):
        yield from _rules(label, model, omega)
        if len(model.local_polynomials()) > 1:
            yield from _places(label, model, train, omega)
    elif isinstance(model, LinearModel):
        yield from _intervals(label, model, omega, band)


def _intervals(
    label: str, model: LinearModel, omega: FloatArray, band: tuple[float, float]
) -> Iterator[Picture]:
    if not model.is_stable:
        yield label, None
        return
    found = model.frequency_response(omega)
    centre = found.response[:, 0, 0]
    yield label, centre
    inside = np.clip(omega, *band)
    size = np.interp(inside, omega, found.magnitude_error[:, 0, 0] / np.maximum(np.abs(centre), 1e-300))
    turn = np.interp(inside, omega, found.phase_error[:, 0, 0])
    if not (np.isfinite(size).all() and np.isfinite(turn).all()):
        return
    for words, sign in (("high", 1.0), ("low", -1.0)):
        moved = np.exp(sign * Z95 * size - 1j * Z95 * turn)
        yield f"{label}, gain {words} and phase late in its interval", np.asarray(centre * moved)


def _rules(label: str, model: LocallyLinear, omega: FloatArray) -> Iterator[Picture]:
    rules = model.local_polynomials()
    dt_s = model.dt_s  # type: ignore[attr-defined]
    back = np.exp(-1j * omega * dt_s)
    for i, (a, b, _) in enumerate(rules):
        own = a[:, 0, 0]
        name = f"{label}, rule {i + 1}" if len(rules) > 1 else label
        if len(own) and np.abs(np.roots(np.concatenate([[1.0], -own]))).max() >= 1.0:
            yield name, None
            continue
        above = np.polyval(b[::-1, 0, 0], back)
        below = 1.0 - back * np.polyval(own[::-1], back)
        yield name, np.asarray(above / below)


def _places(label: str, model: LocallyLinear, train: Dataset, omega: FloatArray) -> Iterator[Picture]:
    """A model of rules where it is smooth: at speeds of the training flights, with the input found there."""
    output = train.outputs[0]
    y = np.concatenate([s.y[:, 0] for s in train.segments])
    u = np.concatenate([s.u[:, 0] for s in train.segments])
    for speed in np.quantile(y, SPEEDS):
        near = np.abs(y - speed) <= np.quantile(np.abs(y - speed), 0.05)
        place = {output.name: float(speed), train.inputs[0].name: float(u[near].mean())}
        name = f"{label} at {output.name} = {speed:.2g} {output.unit}"
        try:
            local = model.linearise(place)  # type: ignore[attr-defined]
        except UsageError:
            continue  # at its limit the output does not move: no plant
        if np.abs(np.linalg.eigvals(local.A)).max(initial=0.0) >= 1.0:
            yield name, None
            continue
        z = np.exp(1j * omega * model.dt_s)  # type: ignore[attr-defined]
        states = z[:, None, None] * np.eye(len(local.A)) - local.A
        answer = local.C @ np.linalg.solve(states, local.B.astype(np.complex128))
        yield name, np.asarray(answer[:, 0, 0] + local.D[0, 0])
