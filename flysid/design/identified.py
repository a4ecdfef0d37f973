"""Whether flights identify a plant well enough to hang gains on it; if not, why, and what to fly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset
from flysid.errors import DataError
from flysid.loops.blackbox_loops import LARGEST_SHARE
from flysid.model.base import Fitted
from flysid.model.capabilities import LinearModel
from flysid.model.frequency.response import measure_response
from flysid.model.structures import row_of
from flysid.showing import counted
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare.verdict import Verdict
from flysid.validate.compare_models import compare
from flysid.validate.runs.run import HeldOut
from flysid.validate.transfers.agreement import agree

SPEED = "m/s"
GOOD_WITHIN = 1.5
"""A model is good whose free run errs at most so many times as much as the best one's."""


@dataclass(frozen=True, eq=False)
class Identified:
    """What a design may use of a channel.

    `models`: those whose free run is at most half as bad again as the best one's, on held-out flights, and
        the linear baseline, which alone states intervals on gain and delay.
    `band`: rad/s, where the coherence of input and output counts.
    `noise`: of the measured output from sample to sample, its unit.
    `reach`: largest input that was flown.
    """

    name: str
    models: Mapping[str, Fitted]
    train: Dataset
    band: tuple[float, float]
    noise: float
    reach: float


def identify(item: HeldOut, limit: float | None) -> Identified:
    """What may be used of a channel of a run.

    `limit`: of the input, where it is known.
    Raises DataError: the flights do not identify the plant, or the channel is none that a position loop goes
    round; the hint says what to fly next.
    """
    train = item.train
    _check_units(train)
    _check_doubts(item)
    _check_limits(train, limit)
    try:
        band = measure_response(train).band()
    except DataError as error:
        raise DataError(f"no frequency response can be measured: {error}", hint=error.hint) from error
    if band is None:
        raise DataError(
            f"{train.outputs[0].name} coheres with {train.inputs[0].name} at no frequency",
            hint="fly a slow sweep of the input, a minute, in calm air",
        )
    return Identified(
        train.name,
        _good(item),
        train,
        band,
        _noise(train),
        float(max(np.abs(s.u).max() for s in train.segments)),
    )


def _check_units(train: Dataset) -> None:
    if len(train.inputs) != 1 or len(train.outputs) != 1:
        raise DataError(
            f"{counted(len(train.inputs), 'input')} and {counted(len(train.outputs), 'output')} "
            "are not a single loop",
            hint="choose a channel from one tilt to one velocity",
        )
    if train.outputs[0].unit != SPEED:
        raise DataError(
            f"a position loop goes round a velocity in m/s, and {train.outputs[0].name} is in "
            f"{train.outputs[0].unit or 'no unit'}",
            hint="choose a channel from tilt to velocity",
        )


def _check_doubts(item: HeldOut) -> None:
    from flysid.ingest.align.doubts import REMARKS

    for doubt in item.channel.doubts:
        if doubt.kind not in REMARKS:
            raise DataError(doubt.text, hint=doubt.todo)
    if item.channel.loops:
        raise DataError(
            item.channel.loops[0],
            hint="fly with an excitation from outside (SYSID, a sweep on the sticks in a manual mode), and "
            "fit with it as reference",
        )


def _check_limits(train: Dataset, limit: float | None) -> None:
    y = np.concatenate([s.y[:, 0] for s in train.segments])
    flat = float(np.mean((y == y.max()) | (y == y.min())))
    if flat > LARGEST_SHARE:
        raise DataError(
            f"{train.outputs[0].name} stands at its extremes for {100.0 * flat:.0f} % of the time: the "
            "sensor is at its limit",
            hint="fly slower",
        )
    if limit is None:
        return
    u = np.concatenate([s.u[:, 0] for s in train.segments])
    share = float((np.abs(u) >= 0.999 * limit).mean())
    if share > LARGEST_SHARE:
        raise DataError(
            f"{train.inputs[0].name} is at its limit of {limit:g} for {100.0 * share:.0f} % of the time: "
            "what is seen is the limit",
            hint="fly gentler",
        )


def _good(item: HeldOut) -> dict[str, Fitted]:
    usable = {k: m for k, m in item.models.items() if row_of(m.structure).has_memory}
    if "mean" not in item.models or item.channel.baseline not in usable:
        raise DataError(
            "the run holds no linear model beside the mean", hint="fit again with the usual models"
        )
    judged = compare(item.models, item.test, horizons=(FREE_RUN,), baseline="mean", seen=item.seen)
    entry = judged.entries[0]
    linear = item.channel.baseline
    pair = entry.pairs[linear]
    if pair.verdict is not Verdict.BETTER:
        _check_followed(item, f"{pair.verdict} ({pair.reason})")
    error = {k: entry.models[k].scores.rmse for k in usable if not entry.models[k].diverged}
    best = min(error.values())
    good = {k: usable[k] for k in error if error[k] <= GOOD_WITHIN * best or k == linear}
    if not any(_has_interval(m) for m in good.values()):
        raise DataError(
            "no model states an interval on its gain and delay", hint="fit with the models arx, oe or tf"
        )
    return good


def _check_followed(item: HeldOut, verdict: str, *, share: float = 0.8, known_to: float = 0.1) -> None:
    """Raise DataError where a linear model that no verdict prefers to a constant is not right either about
    the response of the held-out flights, which is what gains hang on.

    Few flights may show no difference of free runs, in which drift counts most, and yet the response near a
    crossover to a tenth.

    `share`: of the held-out part's trusted band that the model has to follow.
    `known_to`: half width of the interval of ln |G| and of the phase in rad up to which a point counts.
    """
    label = item.channel.baseline
    model = item.models[label]
    followed = 0.0
    if isinstance(model, LinearModel):
        followed = _followed(model, item.test, known_to)
    if followed < share:
        raise DataError(
            f"on held-out flights the linear model {label!r} is not shown to be better than a constant: "
            f"{verdict}; and it follows the response measured there in {100.0 * followed:.0f} % of the band, "
            f"{100.0 * share:.0f} % are needed",
            hint="fly more, and steps or sweeps of this input alone in calm air",
        )


def _followed(model: LinearModel, test: Dataset, known_to: float) -> float:
    """Share of the band measured on these flights in which the model follows; 0 where none is."""
    try:
        measured = measure_response(test)
    except DataError:
        return 0.0
    inside = measured.trusted() > 0.0
    known = inside & (measured.half_width()[:, 0] <= known_to)
    near = agree(measured, 0, model.frequency_response(measured.omega).response[:, 0, 0])
    return float((near & known).sum() / inside.sum()) if known.any() else 0.0


def _has_interval(model: Fitted) -> bool:
    if not isinstance(model, LinearModel):
        return False
    found = model.frequency_response(np.array([0.1 / model.dt_s]))
    return bool(np.isfinite(found.magnitude_error).all() and np.isfinite(found.phase_error).all())


def _noise(train: Dataset) -> float:
    """White noise by second differences, which hardly know of motion."""
    second = np.concatenate([np.diff(s.y[:, 0], 2) for s in train.segments if len(s) > 2])
    return float(np.sqrt((second**2).mean() / 6.0))
