"""Records of a plant: excited, logged and disturbed in ways drawn at random, open or in a loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from bench.truth.bends import MOVING, REALISATIONS, STATIC, bend, best_linear, moving_plant
from bench.truth.laws import LOOPS, Law, draw_law, log_loop
from bench.truth.plants import KINDS, Plant, draw_plant
from flysid.dataset import Dataset, FloatArray, Segment
from flysid.ingest.align.quick import dataset_from
from flysid.ingest.synth.manoeuvres import chirp, pilot, random_phase_multisine
from flysid.model.frequency.sampling import sample
from flysid.model.polynomials import ComplexArray

IntArray = npt.NDArray[np.int64]

FINE = 8
"""Steps of the simulation in one of the log."""
NOISES = ("none", "white", "coloured", "drifting", "gusts", "outliers")
LOGGINGS = ("plain", "quantised", "jitter", "gap", "slow", "event-logged", "merged")
STAMPS = ("late stamps", "two clocks")
EXCITATIONS = ("steps", "pilot", "chirp", "multisine")
DRAWS = ("linear", "stamps", "loops", "bent")
"""Linear plants, open or with a gain around them; stamps that are off; more controllers; bent plants."""
OFF_PPM = 40.0
"""How far two clocks of a record run apart at most: two quartzes of 20 ppm each."""


@dataclass(frozen=True, eq=False)
class Record:
    """One record and all that was drawn for it.

    Attributes
    ----------
    plant : what the stamps of the record show of it. Of a bent record the best linear approximation: the
        response scaled by what the bend leaves of it at these sizes (Bussgang, 1952).
    kinds : plant, noise, logging, excitation, loop, bend.
    controller : from the output back to the input; None in open loop.
    approximation : the response itself, of a plant whose bend has a memory; None of others.
    """

    seed: int
    plant: Plant
    data: Dataset
    kinds: dict[str, str]
    controller: Law | None
    approximation: Callable[[FloatArray], ComplexArray] | None = None

    @property
    def reference(self) -> str:
        """Where the reference that is logged enters; "" where none is."""
        return self.controller.at if self.controller is not None else ""

    def response(self, omega: FloatArray) -> ComplexArray:
        """(F,) the truth of what is measured."""
        if self.approximation is not None:
            return self.approximation(omega)
        return self.plant.response(omega, self.data.dt_s)


def draw_record(seed: int, draw: str = "linear") -> Record:
    """The record of a seed, of one of DRAWS."""
    rng = np.random.default_rng(seed)
    kinds = {
        "plant": str(rng.choice(KINDS)),
        "noise": str(rng.choice(NOISES)),
        "logging": str(rng.choice(LOGGINGS)),
        "excitation": str(rng.choice(EXCITATIONS)),
        "loop": str(rng.choice(("open", LOOPS[0]), p=[0.7, 0.3])),
        "bend": "none",
    }
    if draw == "stamps":
        kinds |= {"loop": "open", "logging": str(rng.choice(STAMPS))}
    elif draw == "loops":
        kinds["loop"] = str(rng.choice(LOOPS))
    elif draw == "bent":
        kinds |= {"loop": "open", "bend": str(rng.choice(STATIC + MOVING))}
    if kinds["bend"] in MOVING:
        return _log_moving(rng, seed, kinds)
    plant = draw_plant(rng, kinds["plant"])
    if kinds["loop"] != "open":
        kinds["logging"] = "plain"
    if kinds["logging"] == "event-logged":
        kinds["excitation"] = "uneven steps"
    rate = plant.corner / (2.0 * np.pi) * rng.uniform(*((12, 25) if kinds["logging"] == "slow" else (25, 90)))
    dt_s = 1.0 / rate
    count = round(float(rng.uniform(60.0, 200.0)) * 2.0 * np.pi / plant.corner / 2.0 / dt_s)
    drive = _excite(rng, kinds["excitation"], plant, dt_s * np.arange(count, dtype=np.float64))
    if kinds["loop"] == "open":
        late_s = dt_s * rng.uniform(0.0, 3.0) if kinds["logging"] == "late stamps" else 0.0
        data, left = _log_open(rng, plant, drive, dt_s, kinds, late_s)
        return Record(seed, plant.scaled(left).delayed(late_s), data, kinds, None)
    law = draw_law(rng, kinds["loop"], plant, dt_s)
    period = 2.0 * np.pi / plant.corner / dt_s
    noise = float(rng.uniform(0.01, 0.15)) * _noise(rng, kinds["noise"], count, period)
    return Record(seed, plant, log_loop(plant, law, drive, dt_s, noise), kinds, law)


def _log_moving(rng: np.random.Generator, seed: int, kinds: dict[str, str]) -> Record:
    """A plant whose bend has a memory, in a plain log; a chirp has no best linear approximation."""
    kinds |= {"logging": "plain", "plant": "second order" if kinds["bend"] == "backlash" else "first order"}
    if kinds["excitation"] == "chirp":
        kinds["excitation"] = "multisine"
    plant = draw_plant(rng, kinds["plant"])
    dt_s = 2.0 * np.pi / plant.corner / rng.uniform(25, 60)
    count = round(float(rng.uniform(30.0, 100.0)) * 2.0 * np.pi / plant.corner / dt_s)
    time_s = dt_s * np.arange(count, dtype=np.float64)
    drives = np.array([_excite(rng, kinds["excitation"], plant, time_s) for _ in range(1 + REALISATIONS)])
    u = drives / drives.std(axis=1, keepdims=True)
    respond = moving_plant(kinds["bend"], float(rng.random()), plant, dt_s / FINE)
    clean = respond(np.repeat(u, FINE, axis=1))[:, ::FINE]
    noise = _noise(rng, kinds["noise"], count, 2.0 * np.pi / plant.corner / dt_s)
    y = clean[0] + float(rng.uniform(0.01, 0.15)) * clean[0].std() * noise
    data = Dataset.from_arrays(u[0], y, dt_s, inputs=["u"], outputs=["y"])
    return Record(seed, plant, data, kinds, None, best_linear(u[1:], clean[1:], dt_s))


def _excite(rng: np.random.Generator, kind: str, plant: Plant, time_s: FloatArray) -> FloatArray:
    corner_hz = plant.corner / (2.0 * np.pi)
    low = max(0.05 * corner_hz, 2.0 / time_s[-1])
    if kind == "chirp":
        return chirp(time_s, (low, 4.0 * corner_hz), 1.0)
    if kind == "multisine":
        return random_phase_multisine(time_s, (low, 4.0 * corner_hz), 1.0, rng)
    if kind == "pilot":
        return pilot(time_s * corner_hz, 1.0, rng)
    if kind == "uneven steps":
        lengths = rng.uniform(0.1, 1.0, len(time_s)) / corner_hz / time_s[1]
        held = np.repeat(rng.standard_normal(len(time_s)), np.maximum(np.round(lengths).astype(int), 2))
        return np.asarray(held[: len(time_s)])
    hold = max(round(float(rng.uniform(0.2, 0.6)) / corner_hz / time_s[1]), 1)
    return np.repeat(rng.standard_normal(len(time_s) // hold + 1), hold)[: len(time_s)]


def _noise(rng: np.random.Generator, kind: str, count: int, period: float) -> FloatArray:
    """(count,) of standard deviation 1; `period`: samples of the plant's corner."""
    white = rng.standard_normal(count)
    if kind == "none":
        return np.zeros(count)
    if kind == "outliers":
        return np.asarray(np.where(rng.random(count) < 0.005, 8.0 * white, 0.5 * white))
    slow = {"coloured": 0.1, "gusts": 0.5, "drifting": 10.0}.get(kind)
    if slow is None:
        return np.asarray(white)
    made = np.asarray(lfilter([1.0], [1.0, -np.exp(-1.0 / (slow * period))], white))
    return np.asarray(made / max(float(made.std()), 1e-300))


def _log_open(
    rng: np.random.Generator,
    plant: Plant,
    u: FloatArray,
    dt_s: float,
    kinds: dict[str, str],
    late_s: float,
) -> tuple[Dataset, float]:
    """The record, and what a bend leaves of the response: 1 where there is none.

    `late_s`: how much later than it was taken the output is stamped.
    """
    a, (b,) = sample(plant.transfer, dt_s / FINE, "zero")
    changes, values = _changes(rng, u, kinds["logging"])
    held = values[np.searchsorted(changes, np.arange(FINE * len(u)), side="right") - 1]
    if kinds["bend"] == "Wiener":
        fine, left = bend(rng, kinds["bend"], np.asarray(lfilter(b, a, held)))
    else:
        moved, left = bend(rng, kinds["bend"], held)
        fine = np.asarray(lfilter(b, a, moved))
    at = FINE * np.arange(len(u), dtype=np.float64)
    if kinds["logging"] == "jitter":
        at += FINE * min(0.005 / dt_s, 0.5) * rng.uniform(-0.5, 0.5, len(u))
    elif kinds["logging"] == "two clocks":
        at *= 1.0 + 1e-6 * OFF_PPM * rng.uniform(-1.0, 1.0)
    at -= FINE * late_s / dt_s
    clean = np.interp(at, np.arange(len(fine)), fine)
    period = 2.0 * np.pi / plant.corner / dt_s
    size = float(rng.uniform(0.01, 0.15)) * clean.std()
    y = clean + size * _noise(rng, kinds["noise"], len(u), period)
    if kinds["logging"] == "quantised":
        grain = float(rng.uniform(0.01, 0.1)) * clean.std()
        y = np.round(y / grain) * grain
    if kinds["logging"] in ("event-logged", "merged"):
        fine_s = dt_s / FINE
        columns = {"u": (np.asarray(fine_s * changes, dtype=np.float64), values), "y": (fine_s * at, y)}
        return _read_table(columns), left
    data = Dataset.from_arrays(u, y, dt_s, inputs=["u"], outputs=["y"])
    if kinds["logging"] == "gap":
        middle = len(u) // 2
        skipped = round(float(rng.uniform(0.5, 3.0)) * period)
        whole = data.segments[0]
        parts = tuple(_cut(whole, part, dt_s) for part in (slice(middle), slice(middle + skipped, None)))
        data = Dataset(dt_s, data.inputs, data.outputs, parts, data.name)
    return data, left


def _changes(rng: np.random.Generator, u: FloatArray, logging: str) -> tuple[IntArray, FloatArray]:
    """When a command takes which value, in steps of the simulation: with the log, on change, at a rate."""
    count = len(u)
    if logging == "event-logged":
        new = np.flatnonzero(np.append(True, np.diff(u) != 0.0))
        late = rng.integers(0, FINE, len(new))
        late[0] = 0
        return FINE * new + late, u[new]
    if logging == "merged":
        at = np.arange(0, FINE * count, int(rng.choice([5, 6, 7, 10, 11])), dtype=np.int64)
        return at, u[at // FINE]
    return FINE * np.arange(count, dtype=np.int64), u


def _read_table(columns: Mapping[str, tuple[FloatArray, FloatArray]]) -> Dataset:
    """u to y of a table in which every row has the one value that was logged then."""
    rows = sorted(
        (float(t), ",".join(f"{x:.9g}" if own == name else "" for own in columns))
        for name, (times, values) in columns.items()
        for t, x in zip(times, values, strict=True)
    )
    text = "\n".join([f"time_s,{','.join(columns)}", *(f"{t:.6f},{cells}" for t, cells in rows), ""])
    with TemporaryDirectory() as folder:
        path = Path(folder) / "merged.csv"
        path.write_text(text, "utf-8")
        return dataset_from(path, "u", "y")


def _cut(whole: Segment, part: slice, dt_s: float) -> Segment:
    start_ns = whole.t0_ns + round((part.start or 0) * dt_s * 1e9)
    return replace(whole, u=whole.u[part], y=whole.y[part], t0_ns=start_ns)
