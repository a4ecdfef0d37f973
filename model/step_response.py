"""The step response that ordinary flying shows: from stick or setpoint to rate or attitude, with intervals.

The impulse response is estimated with a smooth, decaying prior (the TC kernel, see `fir`) on signals that the
autoregression of what it leaves over has whitened, in turns, so that its covariance knows the noise's colour
(generalised least squares; Chen, Ohlsson & Ljung, 2012, Automatica 48). In the last turn priors of systems of
low order stand beside it (`low_order_response`). Summed it is the step response. A long response has fewer
taps than the log has samples: the impulse response is then a line between taps. Inputs are weighted
accordingly before both sides are slowed down alike, which leaves the equation between them exact. Where the
input answers the output (`feedback`), no step response is in the record, and the error says so.
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
from flysid.model.polynomials import Z95, ComplexArray
from flysid.model.shared import digest, once
from flysid.model.step_figures import StepCurve, StepFigure
from flysid.model.threads import on_one_thread
from flysid.showing import significant

BoolArray = npt.NDArray[np.bool_]
EDGE = 10
"""Slow samples at either end of a segment that the filter of `decimate` fills with what was not logged."""


@dataclass(frozen=True, eq=False)
class _Record:
    """One segment about its mean, in units of standard deviations.

    `u`: (N, n_u) inputs, weighted by the line from a tap to its neighbours.
    `first`: (N, n_u) the same for the tap at 0, which has a neighbour on one side only.
    `y`: (N,) the output.
    """

    u: FloatArray
    first: FloatArray
    y: FloatArray


@dataclass(frozen=True, eq=False)
class StepResponse:
    """What a step of height 1 does to the output.

    `time_s`, `step`: (N,) of the mean of the posterior, output unit per input unit.
    `covariance`: (N, N) of the step.
    `seconds`: how much flying it rests on.
    `words`: of which part of the record it speaks; "" for all.
    `confirmed`: it has settled, and one of another length agrees with it.
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

    def frequency_response(self, omega: FloatArray, dt_s: float) -> tuple[ComplexArray, FloatArray]:
        """(F,) of the impulse response whose sum this is, and its relative standard errors.

        Between two times the log's samples, `dt_s` apart, are taken to add alike.
        """
        sample_s = float(self.time_s[1])
        inner = np.arange(max(round(sample_s / dt_s), 1))
        within = np.exp(1j * np.outer(omega, inner * dt_s)).mean(axis=1)
        turns = np.exp(-1j * np.outer(omega, self.time_s))
        turns[:, 1:] *= within[:, None]
        of_step = turns - np.column_stack([turns[:, 1:], np.zeros(len(omega))])
        g = np.asarray(of_step @ self.step)
        variance = np.einsum("fi,ij,fj->f", of_step, self.covariance, of_step.conj()).real
        size = np.maximum(np.abs(g), np.finfo(float).tiny)
        return g, np.sqrt(np.maximum(variance, 0.0) / 2.0) / size

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
        """The response ends within its length: it looks so, and one of another length agrees."""
        return self.confirmed

    @property
    def looks_settled(self) -> bool:
        """It ends within its length, if what is cut off there is nothing."""
        return self._curve.is_settled

    @property
    def _curve(self) -> StepCurve:
        return StepCurve(self.time_s, self.step, self.covariance, self.output.unit)


@once(lambda data, *pair, **how: (digest(data), pair, repr(sorted(how.items()))))
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
    first_s: float = 1.0,
    anyway: bool = False,
) -> StepResponse:
    """The step response of one input and one output; other inputs are fitted along.

    `horizon_s`: its length, seconds; None doubles it from `first_s` until the response has settled and one of
        twice the length agrees, or the record holds no longer one.
    `above`, `below`: count only samples within a horizon of which the input's size went above, or stayed
        below, this (as PID analysers tell a fast stick from a slow one), in the input's unit.
    `anyway`: also where the input answers the output; `words` then says so, beside every figure.
    Raises UsageError: a horizon that is no length. Raises DataError: the input answers the output (a loop),
    too short, a signal that never moves, or no sample of the class that was asked for.
    """
    if horizon_s is not None and not horizon_s > 0.0:
        raise UsageError(f"horizon_s must be positive, not {horizon_s}")
    caution = _check_loop(data, output, anyway)
    how = _How(output, source, above, below, most_taps, rounds)
    found = _settled(data, how, first_s, horizon_s)
    return replace(found, words=", ".join(filter(None, (found.words, caution))))


def _settled(data: Dataset, how: _How, first_s: float, horizon_s: float | None) -> StepResponse:
    """The first that has settled and agrees with one of half its length; or of the length that is given."""
    if horizon_s is not None:
        found = _respond(data, how, horizon_s)
        longer = _longer(data, how, found.length_s)
        return found if longer is None else _held_against(found, longer)
    found = _respond(data, how, first_s)
    while longer := _longer(data, how, found.length_s):
        held = _held_against(longer, found)
        if held.is_settled:
            return held
        found = longer
    return found


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


def _held_against(
    found: StepResponse, other: StepResponse, *, share: float = 0.05, most: float = 0.25
) -> StepResponse:
    """With what a response of another length says otherwise as an error of its own.

    What the length cuts off falls upon the taps that are left, under a prior that lets them fade: a response
    that goes on may look settled, but not of the same size at twice the length.

    `share`: of the largest value, beyond which and beyond chance the two contradict one another. `most`: and
    however little the record tells, as two lengths of what never ends differ by more.
    """
    off = np.interp(found.time_s, other.time_s, other.step) - found.step
    off[found.time_s > other.time_s[-1]] = 0.0
    chance = np.hypot(found.error, np.interp(found.time_s, other.time_s, other.error))
    largest = float(np.abs(found.step).max())
    agree = bool((np.abs(off) <= np.minimum(share * largest + Z95 * chance, most * largest)).all())
    return replace(
        found, covariance=found.covariance + np.outer(off, off), confirmed=agree and found.looks_settled
    )


def _respond(data: Dataset, how: _How, horizon_s: float) -> StepResponse:
    """The response of one length."""
    output, source, above, below = how.output, how.source, how.above, how.below
    factor = max(int(np.ceil(horizon_s / data.dt_s / how.most_taps)), 1)
    dt_s = factor * data.dt_s
    taps = max(round(horizon_s / dt_s), 2)
    records, scale = _records(data, output, factor, taps)
    masks = [_mask(r.u[:, source] * scale[source], taps, above, below) for r in records]
    samples = sum(int(m[taps - 1 :].sum()) for m in masks)
    largest = max(float(np.abs(r.u[:, source]).max()) * scale[source] for r in records)
    if above is not None and largest <= above:
        raise DataError(
            f"{data.inputs[source].name} never exceeds {above:g}: at most {significant(largest)}",
            hint="a smaller size: what parts slow input from fast lies below the largest that was flown",
        )
    if samples < 2 * taps:
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
    total = _sums(taps, factor)
    return StepResponse(
        time_s=dt_s * np.arange(taps, dtype=np.float64),
        step=unit * (total @ posterior.mean[own]),
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


def _sums(taps: int, factor: int) -> FloatArray:
    """(taps, taps) from taps to their sums at the time of each: lines between, `factor` samples long."""
    before = np.tril(np.ones((taps, taps)), -1)
    half = (factor + 1.0) / (2.0 * factor)
    total = before + half * np.eye(taps)
    total[:, 0] = half
    total[0, 0] = 1.0 / factor
    return total


def _records(data: Dataset, output: int, factor: int, taps: int) -> tuple[list[_Record], FloatArray]:
    """Segments about their common mean, in units of their standard deviations, and those units."""
    long = [s for s in data.segments if len(s) >= (taps + 2 * EDGE) * factor]
    if not long:
        raise DataError(
            f"no segment is longer than the response of {taps * factor * data.dt_s:.3g} s",
            hint="a shorter horizon, or longer segments",
        )
    both = [np.column_stack([s.u, s.y[:, output]]) for s in long]
    whole = np.concatenate(both)
    mean = whole.mean(axis=0)
    scale = whole.std(axis=0)
    for i, signal in enumerate((*data.inputs, data.outputs[output])):
        if not scale[i] > 1e-12 * max(abs(float(mean[i])), 1e-300):
            raise DataError(
                f"{signal.name!r} never moves: there is no step response to see",
                hint="choose flights in which it does",
            )
    return [_slow((signals - mean) / scale, factor) for signals in both], scale


def _slow(signals: FloatArray, factor: int) -> _Record:
    """[inputs, output] with one sample in `factor`, without what is finer, inputs weighted for the taps."""
    u, y = signals[:, :-1], signals[:, -1:]
    if factor == 1:
        return _Record(u, u, y[:, 0])
    falling = (1.0 - np.arange(factor) / factor) / factor
    first = apply_filter(falling, ONE, u)
    after = apply_filter(falling, ONE, u[::-1])[::-1]
    line = first + after - falling[0] * u
    slow = decimate(np.hstack([line, first, y]), factor)[EDGE:-EDGE]
    count = u.shape[1]
    return _Record(slow[:, :count], slow[:, count : 2 * count], slow[:, -1])


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
    records: Sequence[_Record], masks: Sequence[BoolArray], d: FloatArray, taps: int
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
    records: Sequence[_Record], masks: Sequence[BoolArray], d: FloatArray, taps: int, *, chunk: int = 4096
) -> Iterator[FloatArray]:
    """[lags of every input, y, 1] of filtered signals, a chunk at a time."""
    for record, mask in zip(records, masks, strict=True):
        white_u, white_first = (apply_filter(d, ONE, x) for x in (record.u, record.first))
        white_y = apply_filter(d, ONE, record.y)
        windows = np.lib.stride_tricks.sliding_window_view(white_u, taps, axis=0)[:, :, ::-1]
        first = taps - 1 + len(d) - 1
        picked = np.flatnonzero(mask[first:]) + first
        for at in range(0, len(picked), chunk):
            k = picked[at : at + chunk]
            lags = windows[k - taps + 1].copy()
            lags[:, :, 0] = white_first[k]
            yield np.column_stack([lags.reshape(len(k), -1), white_y[k], np.ones(len(k))])


def _error(record: _Record, mean: FloatArray, constant: float, taps: int) -> FloatArray:
    """What the response leaves over, without its start."""
    u, y = record.u, record.y
    made = (record.first - u) @ mean[::taps]
    for j in range(u.shape[1]):
        made += np.convolve(u[:, j], mean[j * taps : (j + 1) * taps])[: len(y)]
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
