"""The step response that ordinary flying shows: from stick or setpoint to rate or attitude, with intervals.

The impulse response is estimated with a smooth, decaying prior (the TC kernel, see `fir`) on signals that the
autoregression of what it leaves over has whitened, in turns, so that its covariance knows the noise's colour
(generalised least squares; Chen, Ohlsson & Ljung, 2012, Automatica 48). In the last turn priors of systems of
low order stand beside it (`low_order_response`). Summed it is the step response. Where the input answers the
output (`feedback`), no step response is in the record, and that is said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import DataError, UsageError
from flysid.feedback import feedback
from flysid.model.fir import centred_gram, posterior_of
from flysid.model.low_order_response import averaged_posterior
from flysid.model.noise import noise_model
from flysid.model.polynomials import Z95
from flysid.model.threads import on_one_thread
from flysid.showing import significant

DRAWS = 400

BoolArray = npt.NDArray[np.bool_]
Record = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class StepFigure:
    """One figure of a step response with its 95 % interval; `value` is None where it has none (`why`)."""

    name: str
    unit: str
    value: float | None
    low: float | None = None
    high: float | None = None
    why: str = ""

    def __str__(self) -> str:
        if self.value is None or self.low is None or self.high is None:
            return f"{self.name}: {self.why}"
        return (
            f"{self.name} {significant(self.value)} {self.unit}".rstrip()
            + f" [{significant(self.low)}, {significant(self.high)}]"
        )

    def to_dict(self) -> dict[str, float | str | None]:
        """JSON types only."""
        return {"unit": self.unit, "value": self.value, "low": self.low, "high": self.high, "why": self.why}


@dataclass(frozen=True, eq=False)
class StepResponse:
    """What a step of height 1 does to the output.

    Attributes
    ----------
    time_s, step : (N,) of the mean of the posterior, output unit per input unit.
    covariance : (N, N) of the step.
    seconds : how much flying it rests on.
    words : of which part of the record it speaks; "" for all.
    """

    time_s: FloatArray
    step: FloatArray
    covariance: FloatArray
    input: Signal
    output: Signal
    seconds: float
    words: str = ""

    @property
    def error(self) -> FloatArray:
        """(N,) standard errors."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def interval(self) -> tuple[FloatArray, FloatArray]:
        """Pointwise 95 %."""
        return self.step - Z95 * self.error, self.step + Z95 * self.error

    @property
    def figures(self) -> tuple[StepFigure, ...]:
        """Latency (to 10 %), rise (10 to 90 %), overshoot, settling (within 5 %), final value."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        draws = self.step + np.random.default_rng(0).standard_normal((DRAWS, len(root))) @ root.T
        final = _told("final value", self.output.unit, draws, self.step, _final, least=-np.inf)
        if final.low is None or final.high is None or final.low <= 0.0 <= final.high:
            why = "the step's final value cannot be told from 0"
            names = (("latency", "ms"), ("rise", "ms"), ("overshoot", "%"), ("settling", "s"))
            return (*(StepFigure(n, u, None, why=why) for n, u in names), final)

        def reaches(share: float) -> Callable[[FloatArray], float]:
            return lambda s: 1e3 * _first_time(self.time_s, s / _final(s), share)

        sample_ms = 1e3 * float(self.time_s[1] - self.time_s[0])
        latency = _told("latency", "ms", draws, self.step, reaches(0.1))
        if latency.high is not None:  # one that begins within the first sample is known no finer
            latency = replace(latency, high=max(latency.high, sample_ms))
        return (
            latency,
            _told("rise", "ms", draws, self.step, lambda s: reaches(0.9)(s) - reaches(0.1)(s)),
            _told("overshoot", "%", draws, self.step, _overshoot),
            _told("settling", "s", draws, self.step, lambda s: _settle(self.time_s, s / _final(s))),
            final,
        )


def _told(
    name: str,
    unit: str,
    draws: FloatArray,
    mean: FloatArray,
    figure: Callable[[FloatArray], float],
    least: float = 0.0,
) -> StepFigure:
    """A figure of the mean, its interval by its spread over draws of the posterior; none is below `least`."""
    value = figure(mean)
    spread = np.array([figure(d) for d in draws])
    if not np.isfinite(value) or np.mean(np.isfinite(spread)) < 0.95:
        return StepFigure(name, unit, None, why="not reached within the response's length")
    half = Z95 * float(spread[np.isfinite(spread)].std())
    return StepFigure(name, unit, float(value), max(float(value) - half, least), float(value) + half)


def _final(step: FloatArray) -> float:
    """Mean of the last tenth."""
    return float(step[-max(len(step) // 10, 1) :].mean())


def _overshoot(step: FloatArray) -> float:
    return 100.0 * max(float((step / _final(step)).max()) - 1.0, 0.0)


def _first_time(time_s: FloatArray, step: FloatArray, share: float) -> float:
    above = np.flatnonzero(step >= share)
    if not len(above):
        return np.nan
    k = int(above[0])
    if k == 0:
        return float(time_s[0])
    part = (share - step[k - 1]) / max(step[k] - step[k - 1], 1e-12)
    return float(time_s[k - 1] + part * (time_s[k] - time_s[k - 1]))


def _settle(time_s: FloatArray, step: FloatArray, *, within: float = 0.05) -> float:
    """`within`: of the final value."""
    outside = np.flatnonzero(np.abs(step - 1.0) > within)
    if not len(outside):
        return float(time_s[0])
    return float(time_s[outside[-1]]) if outside[-1] < 0.9 * len(step) else np.nan


@on_one_thread
def step_response(
    data: Dataset,
    output: int = 0,
    source: int = 0,
    *,
    horizon_s: float = 2.0,
    above: float | None = None,
    below: float | None = None,
    most_taps: int = 200,
    rounds: int = 3,
) -> StepResponse:
    """The step response of one input and one output; other inputs are fitted along.

    Parameters
    ----------
    horizon_s : its length, seconds.
    above, below : count only samples within a horizon of which the input's size went above, or stayed below,
        this (as PID analysers tell a fast stick from a slow one), in the input's unit.

    Raises
    ------
    UsageError : a horizon that is no length.
    DataError : the input answers the output (a loop), too short, a signal that never moves, or no sample of
        the class that was asked for.
    """
    if not horizon_s > 0.0:
        raise UsageError(f"horizon_s must be positive, not {horizon_s}")
    _check_loop(data, output)
    factor = max(int(np.ceil(horizon_s / data.dt_s / most_taps)), 1)
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
    for _ in range(rounds):
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
    from scipy.signal import decimate

    found = []
    for segment in data.segments:
        both = np.column_stack([segment.u, segment.y[:, output]])
        if len(both) < (taps + 20) * factor:
            continue
        slow = decimate(both, factor, ftype="fir", axis=0, zero_phase=True) if factor > 1 else both
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
    from scipy.signal import lfilter

    for (u, y), mask in zip(records, masks, strict=True):
        white_u = lfilter(d, [1.0], u, axis=0)
        white_y = lfilter(d, [1.0], y)
        windows = np.lib.stride_tricks.sliding_window_view(white_u, taps, axis=0)[:, :, ::-1]
        first = taps - 1 + len(d) - 1
        picked = np.flatnonzero(mask[first:]) + first
        for at in range(0, len(picked), chunk):
            k = picked[at : at + chunk]
            lags = windows[k - taps + 1].reshape(len(k), -1)
            yield np.column_stack([lags, white_y[k], np.ones(len(k))])


def _error(record: Record, mean: FloatArray, constant: float, taps: int) -> FloatArray:
    """What the response leaves over, without its start."""
    from scipy.signal import fftconvolve

    u, y = record
    made = sum(fftconvolve(u[:, j], mean[j * taps : (j + 1) * taps])[: len(y)] for j in range(u.shape[1]))
    return np.asarray((y - made - constant)[taps - 1 :])


def _runs(errors: Sequence[FloatArray], masks: Sequence[BoolArray], taps: int) -> list[FloatArray]:
    """The stretches of the class alone: elsewhere the response may be another one, which is no noise."""
    found = []
    for error, mask in zip(errors, masks, strict=True):
        edges = np.flatnonzero(np.diff(mask[taps - 1 :])) + 1
        found += np.split(error, edges)[0 if mask[taps - 1] else 1 :: 2]
    return found


def _check_loop(data: Dataset, output: int) -> None:
    found = feedback(data)[output]
    if found.closed:
        raise DataError(
            f"loop: not a step response. {found.seen}",
            hint="take the command that the pilot gives as input, or fly without the outer loop",
        )
