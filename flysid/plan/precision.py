"""How precisely a run knows its vehicle, and how much more flying of the same kind would help.

The information that records hold of a model's parameters adds up: twice as long a flight of the same kind,
with the same disturbance, halves the covariance (Ljung, System Identification, 1999, 9.4). An interval
therefore shrinks with the square root of the time flown. That holds for intervals that are small beside
their figure: a wider one means that the record does not determine it, and is not carried further.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flysid.dataset import Dataset, Signal
from flysid.errors import FlysidError
from flysid.model.base import Fitted
from flysid.model.capabilities import HasIntervals, HasTransferFunctions, LinearModel
from flysid.model.polynomials import Z95
from flysid.model.structures import leaders
from flysid.showing import duration
from flysid.validate.runs.run import HeldOut

UNDETERMINED = 0.5
"""Of the figure: beyond, 1 / x and the like are no straight lines within the interval any more."""


@dataclass(frozen=True)
class Known:
    """A figure of a model and how well it is known.

    `what`: "gain of theta_in to v_x".
    `half_width`: of its 95 % interval.
    `seconds`: of flight that it comes from, held-out part included: more of the same is held out alike.
    """

    channel: str
    model: str
    what: str
    value: float
    unit: str
    half_width: float
    seconds: float

    @property
    def share(self) -> float:
        """Half the interval's width, of the value."""
        return self.half_width / abs(self.value) if self.value else math.inf

    @property
    def is_determined(self) -> bool:
        """The interval is small enough to say what more flying makes of it."""
        return self.share <= UNDETERMINED

    def share_after(self, more_s: float) -> float:
        """`share` after so many more seconds of the same."""
        return self.share * math.sqrt(self.seconds / (self.seconds + more_s))

    def seconds_for(self, share: float) -> float:
        """More seconds of the same until that share is reached; 0 where it is."""
        return max(0.0, self.seconds * ((self.share / share) ** 2 - 1.0))

    def words(self, more_s: float, aim: float | None = None) -> str:
        """One sentence."""
        size = f"{self.what} {self.value:.3g}{' ' + self.unit if self.unit else ''}"
        flown = duration(self.seconds)
        if not self.is_determined:
            spread = f"known to no better than {100 * self.share:.0f} %" if self.share < 10 else "not known"
            return (
                f"{size}: {spread} from {flown}. More of the same helps little: fly a plan that excites it."
            )
        later = f"{duration(more_s)} more of the same make it {_percent(self.share_after(more_s))}"
        if aim is None:
            return f"{size}: known to {_percent(self.share)} from {flown}; {later}."
        needed = self.seconds_for(aim)
        goal = f"{_percent(aim)} takes {duration(needed)} more" if needed else f"{_percent(aim)} is reached"
        return f"{size}: known to {_percent(self.share)} from {flown}; {later}; {goal}."


def known_of_channel(held: HeldOut) -> Iterator[Known]:
    """What the baseline knows, and transfer functions and rules where they were fitted.

    Where a search found no rules worth having, it gave a linear model beside the baseline, which adds
    nothing here.
    """
    seconds = _seconds(held.train) + _seconds(held.test)
    transfers = (label for label, model in held.models.items() if isinstance(model, HasTransferFunctions))
    labels = dict.fromkeys((held.channel.baseline, *transfers, *leaders()))
    for label in labels:
        if label not in held.models or (label in leaders() and isinstance(held.models[label], LinearModel)):
            continue
        yield from known_of_model(held.models[label], seconds, held.channel.name, label, held.train)


def known_of_model(
    model: Fitted, seconds: float, channel: str = "", label: str = "", train: Dataset | None = None
) -> Iterator[Known]:
    """Figures of a linear model, or of every rule, that come with an interval.

    `seconds`: of the flights that it was fitted on.
    `train`: those flights, for a model of rules.
    """
    if isinstance(model, HasTransferFunctions):
        for transfer in model.transfers:
            pair = f"{transfer.input} to {transfer.output}"
            gain = transfer.gain
            unit = _gain_unit(model, transfer.input, transfer.output)
            if np.isfinite([gain.value, gain.error]).all():
                yield Known(channel, label, f"gain of {pair}", gain.value, unit, Z95 * gain.error, seconds)
            if transfer.dead_time.error > 0.0:
                half = Z95 * transfer.dead_time.error
                yield Known(channel, label, f"dead time of {pair}", transfer.dead_time_s, "s", half, seconds)
    elif isinstance(model, LinearModel):
        yield from _gains(model, seconds, channel, label)
    elif isinstance(model, HasIntervals) and train is not None:
        yield from _gains_of_rules(model, train, seconds, channel, label)


def _gains_of_rules(model: Any, train: Dataset, seconds: float, channel: str, label: str) -> Iterator[Known]:
    """Steady gains of every rule; more of the same is as often where the rule holds."""
    try:
        low, high = model.uncertainty(train).gain_interval
    except (FlysidError, np.linalg.LinAlgError):
        return
    for r, rule in enumerate(model.rules()):
        for i, output in enumerate(model.outputs):
            for j, source in enumerate(model.inputs):
                value = float(rule.dc_gain[i, j])
                half = 0.5 * float(high[r, i, j] - low[r, i, j])
                if math.isfinite(value) and math.isfinite(half) and value:
                    what = f"gain of {source.name} to {output.name} of {rule.label}, {rule.condition},"
                    yield Known(channel, label, what, value, _ratio(output, source), half, seconds)


def _gains(model: LinearModel, seconds: float, channel: str, label: str) -> Iterator[Known]:
    """Steady gains; none where the model integrates or has no covariance."""
    with np.errstate(all="ignore"):
        try:
            error = Z95 * model.frequency_response(np.zeros(1)).magnitude_error[0]
        except np.linalg.LinAlgError:
            return
    for i, output in enumerate(model.outputs):
        for j, source in enumerate(model.inputs):
            value = float(model.dc_gain[i, j])
            half = float(error[i, j])
            if math.isfinite(value) and math.isfinite(half) and value:
                unit = _ratio(output, source)
                what = f"gain of {source.name} to {output.name}"
                yield Known(channel, label, what, value, unit, half, seconds)


def band_of_models(models: Sequence[Fitted]) -> tuple[float, float] | None:
    """Hz: from 0.3 times the slowest to 3 times the fastest pole of linear models; None without poles.

    That is the band around a vehicle's modes that flight-test practice sweeps (Tischler & Remple, 2012, 5).
    """
    speeds = np.concatenate([_speeds(m) for m in models if isinstance(m, LinearModel)] or [np.zeros(0)])
    if not len(speeds):
        return None
    return 0.3 * float(speeds.min()) / (2.0 * math.pi), 3.0 * float(speeds.max()) / (2.0 * math.pi)


def _speeds(model: LinearModel) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """|s| of the poles, rad/s, that a record shows: no integrator, none beyond a quarter of its rate."""
    poles = np.asarray(getattr(model, "poles", ()), dtype=np.complex128)
    poles = poles[np.abs(poles) > 0.0]
    speeds = np.abs(np.log(poles)) / model.dt_s
    return np.asarray(speeds[(np.abs(poles - 1.0) > 1e-6) & (speeds < 0.5 * math.pi / model.dt_s)])


def _gain_unit(model: Fitted, source: str, output: str) -> str:
    signals = {s.name: s for s in (*model.inputs, *model.outputs)}
    return _ratio(signals[output], signals[source])


def _ratio(output: Signal, source: Signal) -> str:
    if output.unit == source.unit:
        return ""
    return f"{output.unit or '1'} per {source.unit}" if source.unit else output.unit


def _seconds(data: Dataset) -> float:
    return sum(len(s) for s in data.segments) * data.dt_s


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"
