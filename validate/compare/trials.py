"""Every model over every held-out segment: free runs and k-step predictions from the same start.

All models start alike: each estimates its first lags from the same window of measured samples
(`flysid.model.start`), and the window is left out of every score, at every horizon; so are the k - 1 samples
after it for predictions k steps ahead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import DataError, UsageError
from flysid.model.base import Fitted
from flysid.model.start import drifting_of, own_part, plain_run, run_from_window, start_window, without

FREE_RUN = "free_run"
MIN_SCORED = 10


@dataclass(frozen=True, eq=False)
class StructureTrial:
    """One segment at one horizon, all models.

    Attributes
    ----------
    segment : index in the test dataset.
    first : the first scored row of the segment.
    y : (M, n_y) measured outputs from `first` on.
    yh : (M, n_y) by model name.
    diverged_s : seconds from the segment's start to divergence, by model; only those that diverged.
    """

    segment: int
    first: int
    y: FloatArray
    yh: Mapping[str, FloatArray]
    diverged_s: Mapping[str, float]


def horizon_name(horizon: str | int) -> str:
    """ "free_run", or the number of steps as a string. Raises UsageError: neither."""
    name = str(horizon)
    if name == FREE_RUN or (name.isdecimal() and int(name) >= 1):
        return name if name == FREE_RUN else str(int(name))
    raise UsageError(
        f"horizon {horizon!r} is not understood", hint="use 'free_run' or a number of steps, 1 or more"
    )


def start_of(models: Mapping[str, Fitted]) -> int:
    """n: measured samples that start every model."""
    return max(model.n_init for model in models.values())


def check_models(models: Mapping[str, Fitted], test: Dataset) -> None:
    """Same sample time, inputs and outputs as the data.

    Raises UsageError: a model was fitted for other signals or another sample time.
    """
    if not models:
        raise UsageError("nothing to compare: no model given")
    for name, model in models.items():
        if abs(model.dt_s - test.dt_s) > 1e-6 * test.dt_s:
            raise UsageError(
                f"model {name!r} has sample time {model.dt_s:g} s, the data {test.dt_s:g} s",
                hint="fit it again on this recipe, or resample the data",
            )
        for side in ("inputs", "outputs"):
            theirs, ours = ([s.name for s in getattr(x, side)] for x in (model, test))
            if theirs != ours:
                raise UsageError(
                    f"model {name!r} has the {side} {', '.join(theirs)}, the data {', '.join(ours)}",
                    hint="compare on data of the recipe that it was fitted with",
                )


@dataclass(frozen=True)
class Plan:
    """A horizon, and the lags of the longest model."""

    horizon: str
    lags: int
    dt_s: float

    def first(self, n_samples: int) -> int:
        """The first scored row of a segment of `n_samples`; all rows before it may start the models."""
        ahead = 0 if self.horizon == FREE_RUN else int(self.horizon) - 1
        return start_window(self.lags, n_samples, self.dt_s) + ahead


def run_trials(models: Mapping[str, Fitted], test: Dataset, horizon: str) -> tuple[StructureTrial, ...]:
    """A trial for every segment long enough to score at least 10 samples; the others are left out.

    Raises DataError: no segment is long enough.
    """
    plan = Plan(horizon, start_of(models), test.dt_s)
    trials = tuple(
        _run(models, test, index, plan)
        for index, segment in enumerate(test.segments)
        if len(segment) >= plan.first(len(segment)) + MIN_SCORED
    )
    if not trials:
        longest = max((len(s) for s in test.segments), default=0)
        raise DataError(
            f"no held-out segment can be scored: the longest has {longest} samples, "
            f"{plan.first(longest)} start the models and {MIN_SCORED} must remain",
            hint="hold out longer segments, or use models of a lower order",
        )
    return trials


def _run(models: Mapping[str, Fitted], test: Dataset, index: int, plan: Plan) -> StructureTrial:
    segment = test.segments[index]
    first = plan.first(len(segment))
    drifting = drifting_of(models.values())
    outputs: dict[str, FloatArray] = {}
    diverged: dict[str, float] = {}
    for name, model in models.items():
        yh, at = _model(model, segment, plan.horizon, first, drifting)
        outputs[name], broken = _finite(yh, segment.y)
        at = broken if at is None else at
        if at is not None:
            diverged[name] = (first + at) * test.dt_s
    return StructureTrial(index, first, segment.y[first:], outputs, diverged)


def _model(
    model: Fitted, segment: Segment, horizon: str, first: int, drifting: tuple[bool, ...] | None
) -> tuple[FloatArray, int | None]:
    """The scored rows of the model's output, and the first of them at the output limits in free run.

    `drifting`: the segment has a constant or a drift of its own beside every model; None: it has none.
    """
    own = own_part(model, segment, first, drifting)
    segment = without(segment, own)
    if horizon != FREE_RUN:
        return model.predict(segment.u, segment.y, int(horizon))[first:] + own[first:], None
    yh = plain_run(model, segment, first)[first:]
    return yh + own[first:], _diverged_at(model, yh)


def free_run(model: Fitted, segment: Segment, start: int) -> FloatArray:
    """(N - start, n_y) simulation of `segment`; its first `start` samples only give the initial state."""
    return run_from_window(model, segment, start)[start:]


def _diverged_at(model: Fitted, yh: FloatArray) -> int | None:
    """First row at the output limits, where `simulate` saturates (law 4)."""
    low, high = model.output_limits
    rows = np.flatnonzero(((yh <= low) | (yh >= high)).any(axis=1))
    return int(rows[0]) if len(rows) else None


def _finite(yh: FloatArray, y: FloatArray) -> tuple[FloatArray, int | None]:
    """yh with what is not finite, or absurd, replaced by a value far away, and the first such row."""
    far = 1e3 * max(float(np.max(np.abs(y))), 1.0)
    bad = ~(np.abs(yh) < 1e12 * far)
    if not bad.any():
        return yh, None
    return np.where(bad, far, yh), int(np.flatnonzero(bad.any(axis=1))[0])
