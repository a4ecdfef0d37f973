"""Vehicles of a run: every good model of a channel as it is, and drawn from the distribution of its numbers.

A vehicle comes with the disturbance of a stretch of held-out flight: what was measured beyond the model's
free run. That holds gusts, noise and all that the model does not know.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray
from flysid.design.identified import GOOD_WITHIN, Identified
from flysid.design.law import ComplexArray
from flysid.errors import DataError, UsageError
from flysid.export.lpv import Lpv, to_lpv
from flysid.model.base import Fitted
from flysid.model.capabilities import HasDraws, HasIntervals
from flysid.showing import counted

SPARE = 4
"""Models drawn per vehicle wanted: those that the flights contradict are left out."""


@dataclass(frozen=True, eq=False)
class ModelVehicle:
    """A model of one input and one output that is flown.

    `label`: of the model; " drawn" behind it where its numbers were.
    `body`: its step.
    `delay_s`: of the link, beside the model's own.
    `disturbance`: (N,) added to the velocity, m/s.
    """

    label: str
    body: Lpv
    delay_s: float
    disturbance: FloatArray

    @property
    def late_s(self) -> float:
        """From command to model: an input that acts at once acts a sample later, as no loop can use it."""
        return self.delay_s + (self.body.dt_s if self.acts_at_once else 0.0)

    @property
    def acts_at_once(self) -> bool:
        """An input enters the output, or the choice of rules, of its own sample."""
        return bool(self.body.D.any() or self.body.Q.any())

    def response(self, omega: FloatArray) -> ComplexArray:
        """(F,) of velocity to input about rest, at omega in rad/s."""
        a, b, c, d = about_rest(self.body)
        z = np.exp(1j * omega * self.body.dt_s)
        states = z[:, None, None] * np.eye(len(a)) - a
        found = (c @ np.linalg.solve(states, b.astype(np.complex128)))[:, 0, 0] + d[0, 0]
        return np.asarray(found * np.exp(-1j * omega * self.late_s))


def about_rest(body: Lpv) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A, B, C and D of the blend of rules that speaks where inputs and outputs are zero."""
    w = body.weights(body.P @ body.x0)
    a, b, c, d = (np.tensordot(w, m, 1) for m in (body.A, body.B, body.C, body.D))
    return a, b, c, d


def is_stable_at_rest(body: Lpv) -> bool:
    """Every pole of the blend at rest lies inside the unit circle."""
    return bool(np.abs(np.linalg.eigvals(about_rest(body)[0])).max(initial=0.0) < 1.0)


def draw_vehicles(
    found: Identified,
    test: Dataset,
    count: int,
    seed: int,
    delay_s: tuple[float, float],
    samples: int,
) -> tuple[list[ModelVehicle], tuple[str, ...]]:
    """Vehicles of a channel, spread over its good models, and notes.

    The first vehicle of a model is the model itself. A model that states no distribution is flown once.

    Draws that the training flights contradict are left out: their free run errs more than `GOOD_WITHIN` times
    as much as the model's. Where numbers trade off, a normal distribution has many of them.

    `test`: flights that the models have not seen.
    `count`: of vehicles.
    `delay_s`: ends of the range of the delay beside the models'.
    `samples`: length of a flight.
    Raises UsageError: fewer vehicles than models. Raises DataError: no model can be flown.
    """
    bodies, notes = _bodies(found)
    if not bodies:
        raise DataError(f"{found.name}: no model can be flown: {'; '.join(notes)}")
    if count < len(bodies):
        raise UsageError(
            f"{counted(count, 'vehicle')}, and {found.name} has {counted(len(bodies), 'good model')}",
            hint=f"--vehicles {len(bodies)} or more: every model is flown",
        )
    drawn, more = _drawn(found, list(bodies), count - len(bodies), seed)
    every = [(label, label, body) for label, body in bodies.items()] + drawn
    vehicles = []
    for number, (source, label, body) in enumerate(every):
        rng = np.random.default_rng([seed, number])
        beyond = _stretch(_beyond(found.models[source], test), samples, rng)
        vehicles.append(ModelVehicle(label, body, rng.uniform(*delay_s), beyond))
    return vehicles, (*notes, *more)


def _bodies(found: Identified) -> tuple[dict[str, Lpv], list[str]]:
    """The models that can be stepped and are stable, and why the others cannot be flown."""
    bodies: dict[str, Lpv] = {}
    notes = []
    for label, model in found.models.items():
        try:
            body = to_lpv(model)
        except UsageError as error:
            notes.append(f"{found.name}: {label} is not flown: {error.message}")
            continue
        if is_stable_at_rest(body):
            bodies[label] = body
        else:
            notes.append(f"{found.name}: {label} is not flown: it is unstable by itself")
    return bodies, notes


def _drawn(
    found: Identified, labels: Sequence[str], count: int, seed: int
) -> tuple[list[tuple[str, str, Lpv]], list[str]]:
    """Source, label and body of so many drawn models, in turn of the models that can be drawn."""
    if not count:
        return [], []
    notes = []
    stock: dict[str, Iterator[Lpv]] = {}
    for label in labels:
        most = SPARE * -(-count // len(labels))
        try:
            draws = _draws(found, label, most, seed)
        except (UsageError, DataError) as error:
            notes.append(f"{found.name}: {label} is flown once, as it is: {error.message}")
            continue
        stock[label] = _accepted(draws, found.models[label], found.train)
    drawn: list[tuple[str, str, Lpv]] = []
    while len(drawn) < count:
        turn = [(label, body) for label in stock if (body := next(stock[label], None)) is not None]
        if not turn:
            break
        drawn += [(label, f"{label} drawn", body) for label, body in turn]
    if len(drawn) < count:
        there = counted(len(labels) + len(drawn), "vehicle")
        notes.append(f"{found.name}: {there}: no more draws agree with the flights")
    return drawn[:count], notes


def _accepted(draws: Sequence[Fitted], model: Fitted, train: Dataset) -> Iterator[Lpv]:
    """Steps of the draws that are stable, and good models of the flights as the model itself is."""
    worst = GOOD_WITHIN * _error(model, train)
    for drawn in draws:
        if _error(drawn, train) <= worst:
            body = to_lpv(drawn)
            if is_stable_at_rest(body):
                yield body


def _error(model: Fitted, data: Dataset) -> float:
    """Root mean square of the free run's error."""
    return float(np.sqrt((np.concatenate(_beyond(model, data)) ** 2).mean()))


def _draws(found: Identified, label: str, count: int, seed: int) -> Sequence[Fitted]:
    model = found.models[label]
    if isinstance(model, HasDraws):
        return model.draws(count, seed)
    if isinstance(model, HasIntervals):
        drawn: Sequence[Fitted] = model.uncertainty(found.train).draws(count, seed)
        return drawn
    raise UsageError("it states no distribution of its numbers")


def _beyond(model: Fitted, data: Dataset) -> list[FloatArray]:
    """Of every segment, what was measured beyond the free run, (N,) each."""
    n = model.n_init
    usable = [s for s in data.segments if len(s) > n + 1]
    if not usable:
        raise DataError(
            f"no stretch of flight is longer than {n + 1} samples",
            hint="bring longer flights, or hold more out: --holdout of fit",
        )
    return [(s.y - model.simulate(s.u, s.y[:n]))[n:, 0] for s in usable]


def _stretch(beyond: Sequence[FloatArray], samples: int, rng: np.random.Generator) -> FloatArray:
    """(samples,) from a random place; where a segment is shorter it is flown there and back again."""
    lengths = np.array([len(part) for part in beyond], dtype=np.float64)
    part = beyond[int(rng.choice(len(beyond), p=lengths / lengths.sum()))]
    if len(part) < samples:
        return np.pad(part, (0, samples - len(part)), mode="reflect")
    first = int(rng.integers(len(part) - samples + 1))
    return part[first : first + samples]
