"""From a run to gains: which channels identify a plant, what present gains mean, what may be flown next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from flysid.design.designed import Axis, Design, DesignMeaning
from flysid.design.drawn_plants import PlantSet, Spread, plants_of
from flysid.design.firmware import Firmware, firmware_for
from flysid.design.gain_search import Bounds, Box, search
from flysid.design.identified import Identified, identify
from flysid.design.law import Gains
from flysid.errors import DataError, UsageError
from flysid.progress import tell
from flysid.validate.runs.run import HeldOut, Run, held_out


@dataclass(frozen=True)
class Wish:
    """The request for a design.

    `channels`: names; all that fit when empty.
    `firmware`: "pid", "px4", "ardupilot" or "tum-ardrone".
    `old`: present parameters; none when empty.
    `ms`, `peak`: bounds, see `Bounds`.
    `noise`: input per unit of the output's noise; None: the measured noise moves the input by at most 5 % of
        what was flown.
    `limit`: of the input.
    `spread`: what the vehicle may be besides.
    `feedforward`: find the input per speed of the reference, too.
    `seed`: of the search.
    """

    channels: tuple[str, ...] = ()
    firmware: str = "pid"
    old: Mapping[str, float] = field(default_factory=dict)
    ms: float = 1.6
    peak: float = 1.15
    noise: float | None = None
    limit: float | None = None
    spread: Spread = Spread()  # noqa: RUF009 - frozen
    feedforward: bool = False
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Ready:
    """A channel that may be designed for: its data, its plants with a positive gain, its bounds."""

    data: Identified
    plants: PlantSet
    sign: float
    bounds: Bounds
    firmware: Firmware


def design_run(run: Run, wish: Wish, data: str | Path | None = None) -> Design:
    """Gains for every channel of a run that identifies a plant; the others with the reason.

    Raises UsageError: no such channel. Raises DataError: no channel can be designed for, or no gains keep the
    bounds. Raises StoreError: the run or its data cannot be read.
    """
    ready: list[Ready] = []
    refused: dict[str, tuple[str, str]] = {}
    for item in held_out(wished_channels(run, wish), data):
        tell("checking that the flights identify the plant", channel=item.channel.name)
        try:
            ready.append(ready_channel(item, wish))
        except (DataError, UsageError) as error:
            refused[item.channel.name] = (error.message, error.hint or "")
    if not ready:
        raise none_left(refused)
    tell("searching for gains")
    scheme = ready[0].firmware.scheme
    together = [ready] if scheme.shared else [[r] for r in ready]
    axes = [axis for group in together for axis in _design(group, wish)]
    return Design(
        str(run.folder),
        (wish.firmware, scheme.words),
        tuple(axes),
        refused,
        dict(wish.old),
        _new(ready, axes, wish),
    )


def wished_channels(run: Run, wish: Wish) -> Run:
    """The run with the channels of the wish; UsageError where it has no such channel."""
    run.check_channels(wish.channels)
    names = [c.name for c in run.channels]
    return replace(run, channels=tuple(c for c in run.channels if c.name in (wish.channels or names)))


def none_left(refused: Mapping[str, tuple[str, str]]) -> DataError:
    """What to say where every channel was refused: the first reason, and what to do about it."""
    name, (why, hint) = next(iter(refused.items()))
    return DataError(f"no channel can be designed for; {name}: {why}", hint=hint)


def ready_channel(item: HeldOut, wish: Wish, *, noise_share: float = 0.05) -> Ready:
    """A channel of a run, or DataError, UsageError where it may not be designed for."""
    found = identify(item, wish.limit)
    u = found.train.inputs[0]
    firmware = firmware_for(wish.firmware, _own(wish.old, found.name), u.unit, wish.limit)
    plants = plants_of(found.models, found.train, found.band)
    middle = np.searchsorted(plants.omega, math.sqrt(found.band[0] * found.band[1]))
    sign = 1.0 if np.median(np.cos(np.angle(plants.responses[:, middle]) + 0.25 * np.pi)) >= 0.0 else -1.0
    plants = replace(plants, responses=sign * plants.responses).spread(wish.spread)
    noise = wish.noise or noise_share * (wish.limit or found.reach) / found.noise
    bounds = Bounds(ms=wish.ms, peak=wish.peak, noise=noise, crossover_rad_s=found.band[1])
    return Ready(found, plants, sign, bounds, firmware)


def _own(old: Mapping[str, float], channel: str) -> dict[str, float]:
    """The parameters of a channel: CHANNEL.NAME goes before NAME."""
    own = {name.removeprefix(f"{channel}."): v for name, v in old.items() if name.startswith(f"{channel}.")}
    return {**{name: v for name, v in old.items() if "." not in name}, **own}


def _design(group: Sequence[Ready], wish: Wish) -> list[Axis]:
    """The channels of one set of gains."""
    first = group[0]
    plants = replace(
        first.plants,
        labels=tuple(f"{r.data.name}: {label}" for r in group for label in r.plants.labels),
        responses=np.concatenate([r.plants.responses for r in group]),
    )
    bounds = replace(
        first.bounds,
        noise=min(r.bounds.noise for r in group),
        crossover_rad_s=min(r.bounds.crossover_rad_s for r in group),
    )
    laws: dict[str, Gains] = {}
    notes = []
    like = Gains(1.0, 1.0, on_error=float(first.firmware.scheme.on_error))
    if wish.old:
        present = first.firmware.gains(_own(wish.old, first.data.name))
        _refuse_beyond(present, plants, bounds)
        laws = {"present": present, "present_x2": present.times(2.0)}
        like = present
        still = [g for g in ("integral", "derivative") if getattr(present, g) == 0.0]
        if still:
            notes.append(f"a gain of 0 stays 0 in one flight: {', '.join(still)}")
        try:
            laws["next"] = search(plants, bounds, _one_flight(first, present, wish), wish.seed)
        except DataError as error:
            notes.append(f"for the next flight: {error.message}; keep your gains")
    free = Box.free(plants, bounds, like, with_filter=wish.firmware == "pid")
    if "derivative" not in {**first.firmware.scheme.names, **first.firmware.scheme.optional}:
        free = Box(replace(free.low, derivative=0.0), replace(free.high, derivative=0.0))
    laws["goal"] = search(plants, bounds, free, wish.seed)
    if "present" in laws:
        notes.append(_how_many(laws["present"], laws["goal"]))
    if wish.feedforward:
        laws |= {k: with_feedforward(laws[k], plants) for k in ("next", "goal") if k in laws}
        notes.append("feed-forward: the reference's speed enters the loop, and the input directly")
    notes += [f"left out: {words}" for words in plants.dropped]
    return [_axis(r, laws, bounds, tuple(notes)) for r in group]


def _one_flight(ready: Ready, present: Gains, wish: Wish, *, largest_step: float = 2.0) -> Box:
    """What the vehicle's own parameters may be for the next flight."""
    old = _own(wish.old, ready.data.name)
    least = largest_step * (1.0 - 1e-4)  # room for rounding to the digits that are written
    return Box.around(present, largest_step, lambda tuned: ready.firmware.beyond(tuned, old, least))


def _refuse_beyond(present: Gains, plants: PlantSet, bounds: Bounds) -> None:
    """Raise DataError where the present loop crosses at frequencies that the flights did not show."""
    crossover = DesignMeaning.of(present, plants).crossover_hz[1]
    highest = bounds.crossover_rad_s / (2.0 * np.pi)
    if crossover > highest:
        raise DataError(
            f"with the present gains the loop crosses at {crossover:.2f} Hz, and the flights have no "
            f"information above {highest:.2f} Hz",
            hint=f"fly a sweep of the input up to {2.0 * crossover:.1f} Hz",
        )


def _how_many(present: Gains, goal: Gains) -> str:
    """How many flights lead from the present gains to the goal, by factors of two."""
    names = ("position", "velocity", "integral", "derivative")
    ratios = [getattr(goal, n) / getattr(present, n) for n in names if getattr(present, n) > 0.0]
    steps = max(1, math.ceil(max(abs(math.log2(max(r, 1e-3))) for r in ratios) - 1e-9))
    flights = "1 flight" if steps == 1 else f"{steps} flights"
    return f"where this leads is {flights} away, each to be identified and judged anew"


def with_feedforward(gains: Gains, plants: PlantSet) -> Gains:
    """With the input per speed of the reference that leaves the worst plant least error of a slow reference.

    A reference of speed r' leaves the error (1 - F) / s, F what the loop makes of the reference; judged from
    the lowest frequency to the crossover.
    """
    from scipy.optimize import minimize_scalar

    from flysid.design.law import LoopParts
    from flysid.design.loopfigures import Laws, figures

    parts = LoopParts.at(plants.omega, plants.dt_s)
    found = figures(Laws.of(gains), plants.responses, parts)
    slow = plants.omega <= found.crossover[0].max()
    centre = (gains.velocity + gains.integral * parts.total) * parts.filtered(gains.error_hz)
    if gains.on_error:
        centre = centre + gains.derivative * parts.slope(gains.cut_hz) * parts.filtered(gains.error_hz)
    forward = 1j * plants.omega
    base = plants.responses * parts.place / (1.0 + found.loop[0])

    def worst(lean: float) -> float:
        answer = base * (centre * (gains.position + forward) + lean * forward)
        return float((np.abs(1.0 - answer[:, slow]) ** 2).mean(axis=1).max())

    most = 10.0 * gains.velocity
    return replace(gains, feedforward=float(minimize_scalar(worst, bounds=(1e-6, most), method="bounded").x))


def _axis(ready: Ready, laws: Mapping[str, Gains], bounds: Bounds, notes: tuple[str, ...]) -> Axis:
    train = ready.data.train
    turned = ("the sign of the input is reversed: the output falls as it rises",) if ready.sign < 0.0 else ()
    return Axis(
        ready.data.name,
        train.inputs[0].name,
        train.outputs[0].name,
        (train.inputs[0].unit, train.outputs[0].unit),
        ready.sign,
        train.dt_s,
        laws,
        {name: DesignMeaning.of(law, ready.plants) for name, law in laws.items()},
        bounds,
        ready.plants.labels,
        (ready.data.band[0] / (2.0 * np.pi), ready.data.band[1] / (2.0 * np.pi)),
        notes + turned,
    )


def _new(ready: Sequence[Ready], axes: Sequence[Axis], wish: Wish) -> dict[str, float]:
    """Parameters of the next flight, where there are present ones to go back to."""
    found: dict[str, float] = {}
    for r, axis in zip(ready, axes, strict=True):
        if "next" not in axis.laws:
            continue
        own = r.firmware.stated(axis.laws["next"], _own(wish.old, axis.channel))
        prefix = "" if r.firmware.scheme.shared or len(axes) == 1 else f"{axis.channel}."
        found |= {prefix + name: value for name, value in own.items()}
    return found
