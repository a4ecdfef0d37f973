"""The step response that ordinary flying shows: from stick or setpoint to rate or attitude, with intervals.

The impulse response is estimated with a smooth, decaying prior (the TC kernel, see `fir`) on signals that the
autoregression of what it leaves over has whitened, in turns, so that its covariance knows the noise's colour
(generalised least squares; Chen, Ohlsson & Ljung, 2012, Automatica 48). In the last turn priors of systems of
low order stand beside it (`low_order_response`). Summed it is the step response. Where the input answers the
output (`feedback`), no step response is in the record, and that is said.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import DataError, UsageError
from flysid.feedback import feedback
from flysid.filters import ONE, apply_filter, decimate
from flysid.model.fir import centred_gram, posterior_of
from flysid.model.low_order_response import averaged_posterior
from flysid.model.noise import noise_model
from flysid.model.polynomials import Z95
from flysid.model.step_figures import StepCurve, StepFigure
from flysid.model.threads import on_one_thread
from flysid.showing import significant

BoolArray = npt.NDArray[np.bool_]
Record = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class StepResponse:
    """What a step of height 1 does to the output.

    Attributes
    ----------
    time_s, step : (N,) of the mean of the posterior, output unit per input unit.
    covariance : (N, N) of the step.
    seconds : how much flying it rests on.
    words : of which part of the record it speaks; "" for all.
    confirmed : a response of about twice the length agrees with it.
    """

    time_s: FloatArray
    step: FloatArray
    covariance: FloatArray
    input: Signal
    output: Signal
    seconds: float
    words: str = ""
    confirmed: bool = False

    @property
    def error(self) -> FloatArray:
        """(N,) standard errors."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def interval(self) -> tuple[FloatArray, FloatArray]:
        """Pointwise 95 %."""
        return self.step - Z95 * self.error, self.step + Z95 * self.error

    @property
    def length_s(self) -> float:
        """Of the response."""
        return float(self.time_s[-1] + self.time_s[1])

    @property
    def figures(self) -> tuple[StepFigure, ...]:
        """Latency (to 10 %), rise (10 to 90 %), overshoot, settling (within 5 %), final value."""
        return self._curve.figures if self.confirmed else self._curve.unsettled

    @property
    def is_settled(self) -> bool:
        """The response ends within its length: it looks so, and a longer one agrees."""
        return self.confirmed and self._curve.is_settled

    @property
    def _curve(self) -> StepCurve:
        return StepCurve(self.time_s, self.step, self.covariance, self.output.unit)


@on_one_thread
def step_response(
    data: Dataset,
    output: int = 0,
    source: int = 0,
    *,
    horizon_s: float | None = None,
    above: float | None = None,
    below: float | None = None,
    most_taps: int = 200,
    rounds: int = 3,
    first_s: float = 2.0,
    anyway: bool = False,
) -> StepResponse:
    """The step response of one input and one output; other inputs are fitted along.

    Parameters
    ----------
    horizon_s : its length, seconds; None doubles it from `first_s` until the response has settled and one of
        twice the length agrees, or the record holds no longer one.
    above, below : count only samples within a horizon of which the input's size went above, or stayed below,
        this (as PID analysers tell a fast stick from a slow one), in the input's unit.
    anyway : also where the input answers the output; `words` then says so, beside every figure.

    Raises
    ------
    UsageError : a horizon that is no length.
    DataError : the input answers the output (a loop), too short, a signal that never moves, or no sample of
        the class that was asked for.
    """
    if horizon_s is not None and not horizon_s > 0.0:
        raise UsageError(f"horizon_s must be positive, not {horizon_s}")
    caution = _check_loop(data, output, anyway)
    how = _How(output, source, above, below, most_taps, rounds)
    found = _settled(data, how, first_s, horizon_s)
    return replace(found, words=", ".join(filter(None, (found.words, caution))))


def _settled(data: Dataset, how: _How, first_s: float, horizon_s: float | None) -> StepResponse:
    """Lengthened until it has settled where no length is given, and held against a longer one."""
    found = _respond(data, how, first_s if horizon_s is None else horizon_s)
    while True:
        longer = _longer(data, how, found.length_s)
        if longer is None:
            return found
        held = _held_against(found, longer)
        if held.is_settled or horizon_s is not None:
            return held
        found = longer


@dataclass(frozen=True)
class _How:
    """What `step_response` takes, without the length."""

    output: int
    source: int
    above: float | None
    below: float | None
    most_taps: int
    rounds: int


def _longer(data: Dataset, how: _How, length_s: float) -> StepResponse | None:
    """One of about twice the length; None where the record is too short for any that is clearly longer."""
    for times in (2.0, 1.4):
        try:
            return _respond(data, how, times * length_s)
        except DataError:
            continue
    return None


def _held_against(found: StepResponse, longer: StepResponse, *, share: float = 0.05) -> StepResponse:
    """With what a longer response says otherwise as an error of its own.

    What the length cuts off falls upon the taps that are left, under a prior that lets them fade: a response
    that goes on may look settled, but not of the same size at twice the length.

    `share`: of the largest value, beyond which and beyond chance the two contradict one another.
    """
    off = np.interp(found.time_s, longer.time_s, longer.step) - found.step
    chance = np.hypot(found.error, np.interp(found.time_s, longer.time_s, longer.error))
    largest = float(np.abs(found.step).max())
    agree = bool((np.abs(off) <= share * largest + Z95 * chance).all())
    return replace(found, covariance=found.covariance + np.outer(off, off), confirmed=agree)


def _respond(data: Dataset, how: _How, horizon_s: float) -> StepResponse:
    """The response of one length."""
    output, source, above, below = how.output, how.source, how.above, how.below
    factor = max(int(np.ceil(horizon_s / data.dt_s / how.most_taps)), 1)
    dt_s = factor * data.dt_s
    taps = max(round(horizon_s / dt_s), 2)
    records, scale = _records(data, output, factor, taps)
    masks = [_mask(u[:, source] * scale[source], taps, above, below) for u, _ in records]
    samples = sum(int(m[taps - 1 :].sum()) for m in masks)
    largest = max(float(np.abs(u[:, source]).max()) * scale[source] for u, _ in records)
    if above is not None and largest <= above:
        raise DataError(
            f"{data.inputs[source].name} never exceeds {above:g}: at most {significant(largest)}",
            hint="a smaller size: what parts slow input from fast lies below the largest that was flown",
        )
    if samples < 4 * taps:
        wanted = "" if above is None and below is None else " of the class asked for"
        raise DataError(
            f"{samples * dt_s:.3g} s of flying{wanted} are too short for a response of {horizon_s:g} s",
            hint="a shorter horizon, or longer flights",
        )
    shape = (taps, len(data.inputs))
    d = np.ones(1)
    for _ in range(how.rounds):
        gram, rows = _gram(records, masks, d, taps)
        posterior = posterior_of(centred_gram(gram), rows, 0, shape)
        constant = _constant(gram, posterior.mean) / float(d.sum())
        errors = [_error(record, posterior.mean, constant, taps) for record in records]
        d, _ = noise_model(_runs(errors, masks, taps))
    gram, rows = _gram(records, masks, d, taps)
    posterior = averaged_posterior(centred_gram(gram), rows, shape)
    own = slice(source * taps, (source + 1) * taps)
    unit = scale[-1] / scale[source]
    total = np.tril(np.ones((taps, taps)))
    return StepResponse(
        time_s=dt_s * np.arange(taps, dtype=np.float64),
        step=unit * np.cumsum(posterior.mean[own]),
        covariance=unit**2 * (total @ posterior.covariance[own, own] @ total.T),
        input=data.inputs[source],
        output=data.outputs[output],
        seconds=samples * dt_s,
        words=_class_words(data.inputs[source], above, below),
    )


def _class_words(signal: Signal, above: float | None, below: float | None) -> str:
    said = [f"above {above:g}"] if above is not None else []
    said += [f"below {below:g}"] if below is not None else []
    return f"{signal.name} {' and '.join(said)} {signal.unit}".rstrip() if said else ""


def _records(data: Dataset, output: int, factor: int, taps: int) -> tuple[list[Record], FloatArray]:
    """(u, y) per segment about their means, in units of their standard deviations, slowed down alike."""
    found = []
    for segment in data.segments:
        both = np.column_stack([segment.u, segment.y[:, output]])
        if len(both) < (taps + 20) * factor:
            continue
        slow = decimate(both, factor) if factor > 1 else both
        found.append(np.asarray(slow, dtype=np.float64))
    if not found:
        raise DataError(
            f"no segment is longer than the response of {taps * factor * data.dt_s:.3g} s",
            hint="a shorter horizon, or longer segments",
        )
    whole = np.concatenate(found)
    mean = whole.mean(axis=0)
    scale = whole.std(axis=0)
    for i, signal in enumerate((*data.inputs, data.outputs[output])):
        if not scale[i] > 1e-12 * max(abs(float(mean[i])), 1e-300):
            raise DataError(
                f"{signal.name!r} never moves: there is no step response to see",
                hint="choose flights in which it does",
            )
    return [((r[:, :-1] - mean[:-1]) / scale[:-1], (r[:, -1] - mean[-1]) / scale[-1]) for r in found], scale


def _mask(u: FloatArray, taps: int, above: float | None, below: float | None) -> BoolArray:
    """(N,) samples whose last `taps` inputs are of the class."""
    if above is None and below is None:
        return np.ones(len(u), dtype=bool)
    from scipy.ndimage import maximum_filter1d

    largest = maximum_filter1d(np.abs(u), taps, origin=(taps - 1) // 2)
    good = np.ones(len(u), dtype=bool)
    if above is not None:
        good &= largest > above
    if below is not None:
        good &= largest <= below
    return good


def _gram(
    records: Sequence[Record], masks: Sequence[BoolArray], d: FloatArray, taps: int
) -> tuple[FloatArray, float]:
    """Of signals filtered with d, and how many samples are in it."""
    gram = np.zeros(())
    for block in _rows(records, masks, d, taps):
        gram = gram + block.T @ block
    return gram, float(gram[-1, -1])


def _constant(gram: FloatArray, mean: FloatArray) -> float:
    """What the taps leave of the output's mean."""
    means = gram[-1] / gram[-1, -1]
    return float(means[-2] - means[:-2] @ mean)


def _rows(
    records: Sequence[Record], masks: Sequence[BoolArray], d: FloatArray, taps: int, *, chunk: int = 4096
) -> Iterator[FloatArray]:
    """[lags of every input, y, 1] of filtered signals, a chunk at a time."""
    for (u, y), mask in zip(records, masks, strict=True):
        white_u = apply_filter(d, ONE, u)
        white_y = apply_filter(d, ONE, y)
        windows = np.lib.stride_tricks.sliding_window_view(white_u, taps, axis=0)[:, :, ::-1]
        first = taps - 1 + len(d) - 1
        picked = np.flatnonzero(mask[first:]) + first
        for at in range(0, len(picked), chunk):
            k = picked[at : at + chunk]
            lags = windows[k - taps + 1].reshape(len(k), -1)
            yield np.column_stack([lags, white_y[k], np.ones(len(k))])


def _error(record: Record, mean: FloatArray, constant: float, taps: int) -> FloatArray:
    """What the response leaves over, without its start."""
    u, y = record
    made = sum(np.convolve(u[:, j], mean[j * taps : (j + 1) * taps])[: len(y)] for j in range(u.shape[1]))
    return np.asarray((y - made - constant)[taps - 1 :])


def _runs(errors: Sequence[FloatArray], masks: Sequence[BoolArray], taps: int) -> list[FloatArray]:
    """The stretches of the class alone: elsewhere the response may be another one, which is no noise."""
    found = []
    for error, mask in zip(errors, masks, strict=True):
        edges = np.flatnonzero(np.diff(mask[taps - 1 :])) + 1
        found += np.split(error, edges)[0 if mask[taps - 1] else 1 :: 2]
    return found


def _check_loop(data: Dataset, output: int, anyway: bool) -> str:
    """What to say beside the figures of an input that answers the output; "" in open loop."""
    found = feedback(data)[output]
    if not found.closed:
        return ""
    if anyway:
        return f"a loop seems closed ({100 * found.share:.0f} % of what is new comes back): it bends this"
    raise DataError(
        f"loop: not a step response. {found.seen}",
        hint="take the command that the pilot gives as input, or fly without the outer loop; a loop that "
        "brings back little bends little: --anyway",
    )
