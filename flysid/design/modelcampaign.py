"""A design flown on the identified vehicles of a run: the same laws, rows and page as on simulated ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flysid.design.campaign import Campaign, check_number, row_of_law
from flysid.design.designed import SAID, Axis
from flysid.design.drawn_plants import grid
from flysid.design.identified import identify
from flysid.design.law import LoopParts
from flysid.design.modelflight import fly_models
from flysid.design.modelvehicles import ModelVehicle, draw_vehicles
from flysid.design.trialflight import Flown, course
from flysid.errors import DataError, UsageError
from flysid.progress import tell
from flysid.showing import one_of
from flysid.validate.runs.run import HeldOut, Run, held_out


@dataclass(frozen=True)
class OnModels:
    """How a design is flown on models.

    `vehicles`: of every channel.
    `seed`: of draws, delays and stretches of flight.
    `delay_s`: ends of the range of the delay of the link, beside the models' own.
    `limit`: largest input, in its unit; None: the largest that the models were fitted to.
    """

    vehicles: int = 100
    seed: int = 1
    delay_s: tuple[float, float] = (0.0, 0.0)
    limit: float | None = None


@dataclass(frozen=True, eq=False)
class _Channel:
    axis: Axis
    vehicles: Sequence[ModelVehicle]
    limit: float
    notes: tuple[str, ...]


def fly_on_run(axes: Sequence[Axis], run: Run, how: OnModels, data: str | Path | None = None) -> Campaign:
    """Fly every law of a design on the good models of a run, which may be another one than it was made of.

    `data`: the run's data, if they have moved.
    Raises UsageError: the run has no channel of the design, or one with other signals or another sample time.
    Raises DataError: no channel identifies a plant, see `identify`.
    """
    check_number(how.vehicles)
    if not all(0.0 <= late < 1.0 for late in how.delay_s) or how.delay_s[0] > how.delay_s[1]:
        raise UsageError(f"a delay of {how.delay_s[0]:g} to {how.delay_s[1]:g} s", hint="as 0.02..0.08")
    by_name = {item.channel.name: item for item in held_out(run, data)}
    refused: dict[str, DataError] = {}
    ready: dict[str, _Channel] = {}
    for axis in axes:
        item = by_name.get(axis.channel)
        if item is None:
            hint = one_of(list(by_name), axis.channel)
            raise UsageError(
                f"the run has no channel {axis.channel!r} of the design", path=run.folder, hint=hint
            )
        tell("drawing vehicles", channel=axis.channel)
        try:
            ready[axis.channel] = _ready(axis, item, how)
        except DataError as error:
            refused[axis.channel] = error
    if not ready:
        raise next(iter(refused.values()))
    return _flown(ready, how, tuple(f"{name}: not flown: {e.message}" for name, e in refused.items()))


def _ready(axis: Axis, item: HeldOut, how: OnModels) -> _Channel:
    _check_same(axis, item)
    found = identify(item, None)
    samples = len(course(dt_s=axis.dt_s)[0])
    vehicles, notes = draw_vehicles(found, item.test, how.vehicles, how.seed, how.delay_s, samples)
    limit = found.reach if how.limit is None else how.limit
    words = f"{axis.channel}: {axis.input} up to {limit:.3g} {axis.units[0]}".rstrip()
    if how.limit is None:
        words += ", the largest that was flown: another with --limit"
    return _Channel(axis, vehicles, limit, (words, *notes))


def _check_same(axis: Axis, item: HeldOut) -> None:
    """Raise UsageError where the channel of the run is not the one that the design is for."""
    train = item.train
    own = [(s.name, s.unit) for s in (*train.inputs, *train.outputs)]
    asked = [(axis.input, axis.units[0]), (axis.output, axis.units[1])]
    for what, a, b in (
        ("signals", own, asked),
        ("rates", f"{1.0 / train.dt_s:.4g} Hz", f"{1.0 / axis.dt_s:.4g} Hz"),
    ):
        if a != b:
            raise UsageError(
                f"{axis.channel}: the {what} of run and design differ: {a} and {b}",
                hint="design with this run: flysid design RUN -o DIR",
            )


def _flown(ready: dict[str, _Channel], how: OnModels, refused: tuple[str, ...]) -> Campaign:
    axes = {name: channel.axis for name, channel in ready.items()}
    names = [law for law in SAID if all(law in axis.laws for axis in axes.values())]
    if not names:
        raise UsageError("the channels of the design share no set of gains", hint="design them anew")
    flown: dict[str, list[dict[str, Flown]]] = {}
    by_channel = {}
    for done, (name, c) in enumerate(ready.items()):
        tell("flying", channel=name, share=done / len(ready))
        laws = [c.axis.laws[law] for law in names]
        by_channel[name] = dict(zip(names, fly_models(c.vehicles, laws, c.axis.sign, c.limit), strict=True))
    fewest = min(len(c.vehicles) for c in ready.values())
    for law in names:
        flown[law] = [{name: by_channel[name][law][i] for name in ready} for i in range(fewest)]
    rows = {}
    for name, c in ready.items():
        omega = grid(c.axis.dt_s)
        true = np.array([c.axis.sign * v.response(omega) for v in c.vehicles[:fewest]], dtype=np.complex128)
        parts = LoopParts.at(omega, c.axis.dt_s)
        rows[name] = [row_of_law(law, c.axis.laws[law], name, flown, true, parts) for law in names]
    notes = refused + tuple(note for c in ready.values() for note in c.notes)
    if "present" not in names:
        notes += ("no present gains to compare with: design with --old FILE",)
    laws_of = {name: {law: axis.laws[law] for law in names} for name, axis in axes.items()}
    return Campaign(fewest, how.seed, {"delay_s": how.delay_s}, laws_of, flown, rows, {}, notes)
