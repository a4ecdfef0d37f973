"""Samples at their own times -> one grid: gaps, rates, hold, interpolation, anti-alias filter.

Times are integer nanoseconds of one clock. Commands are held (zero order), states are interpolated
linearly between the two samples around a grid point; neither crosses a gap. Where sources are faster
than the grid, every signal of a channel passes the same zero-phase low-pass first: two signals that
pass one linear filter keep the relation between them (Ljung 1999, System Identification, section 14.3).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from flysid.dataset import LOWPASS_BETA
from flysid.stretch import FloatArray

IntArray = npt.NDArray[np.int64]
Span = tuple[int, int]  # half-open, ns

FOREVER = 1 << 62
GAP_PERIODS = 2.5  # a pause of more than this many periods is a gap: one lost sample is bridged, two are not
TAPS_PER_SIDE = 5  # half length of the low-pass, in grid samples
SPIKE_SAMPLES = 9
NORMAL = 1.4826  # standard deviation over the median absolute deviation, of normal numbers


@dataclass(frozen=True, eq=False)
class RecordedSignal:
    """A signal as recorded, made fit for resampling: (N,) strictly increasing times, (N,) finite values.

    `non_finite`, `duplicates` and `spikes` count the samples that were left out.
    """

    t_ns: IntArray
    x: FloatArray
    non_finite: int = 0
    duplicates: int = 0
    spikes: int = 0

    @cached_property
    def period_ns(self) -> float:
        """Mean distance of samples, in ns; see `period_ns`."""
        return period_ns(self.t_ns)


def tidy(t_ns: IntArray, x: FloatArray, max_rate: float | None = None) -> RecordedSignal:
    """Samples in time order; values that are not finite dropped; of equal times the last one kept.

    With `max_rate`, per second, samples that jump away from their neighbours faster are dropped too.
    """
    finite = np.isfinite(x)
    times = t_ns[finite]
    values = x[finite]
    order = np.argsort(times, kind="stable")
    times = times[order]
    values = values[order]
    last = np.append(np.diff(times) > 0, True)[: len(times)]
    times = times[last]
    values = values[last]
    jumps = spikes(times, values, max_rate) if max_rate is not None else np.zeros(len(times), dtype=bool)
    lost = (int((~finite).sum()), int((~last).sum()), int(jumps.sum()))
    return RecordedSignal(times[~jumps], values[~jumps], *lost)


def spikes(t_ns: IntArray, x: FloatArray, max_rate: float) -> npt.NDArray[np.bool_]:
    """(N,) samples further from the median of nine than `max_rate` allows in half of that stretch."""
    if len(x) < SPIKE_SAMPLES:
        return np.zeros(len(x), dtype=bool)
    half = SPIKE_SAMPLES // 2
    padded = np.pad(x, half, mode="edge")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, SPIKE_SAMPLES), axis=1)
    return np.asarray(np.abs(x - middle) > max_rate * half * period_ns(t_ns) * 1e-9)


def period_ns(t_ns: IntArray) -> float:
    """Mean distance of samples, in ns, with pauses left out; inf where all samples, or one, have one time.

    Where two thirds of the distances lie near their median, the mean of those is taken; otherwise
    (bursts) the mean of all that are below five times the mean.
    """
    if len(t_ns) < 2:
        return float("inf")
    steps = np.diff(t_ns).astype(np.float64)
    middle = float(np.median(steps))
    near = steps[(steps > 0.5 * middle) & (steps < 1.5 * middle)]
    if 3 * len(near) > 2 * len(steps):
        return float(near.mean())
    return float(steps[steps <= 5 * steps.mean()].mean()) or float(steps.mean()) or float("inf")


def jitter_ns(t_ns: IntArray) -> float:
    """How far stamps scatter around an even rate: the standard deviation, by the median; 0 where unknown.

    Of the distances of samples, each of which has the scatter of two stamps; lost samples are left out.
    """
    steps = np.diff(t_ns).astype(np.float64)
    if not len(steps):
        return 0.0
    apart = np.abs(steps - np.median(steps))
    kept = apart[apart < 0.5 * float(np.median(steps))]
    return NORMAL * float(np.median(kept)) / float(np.sqrt(2.0)) if len(kept) else 0.0


def nice_period_ns(period: float) -> int:
    """A sample time near `period` that people would write: whole ms, a whole rate, or three digits."""
    ms = round(period / 1e6)
    if ms >= 1 and abs(period / 1e6 - ms) < 0.005 * ms:
        return ms * 1_000_000
    rate = round(1e9 / period)
    if rate >= 5 and abs(1e9 / period - rate) < 0.005 * rate:
        return round(1e9 / rate)
    return round(float(f"{period:.3g}"))


# ------------------------------------------------------------------------------------------- spans


def spans_between_gaps(
    t_ns: IntArray, max_gap_ns: float, after_ns: float = 1, late_ns: IntArray | None = None
) -> list[Span]:
    """Half-open spans without a pause above `max_gap_ns`; each ends `after_ns` after its last sample.

    `late_ns`: times of samples behind which a pause is none: the next one came late.
    """
    if len(t_ns) == 0:
        return []
    cuts = np.flatnonzero(np.diff(t_ns) > max_gap_ns)
    if late_ns is not None and len(late_ns):
        late = np.sort(late_ns)
        known = np.minimum(np.searchsorted(late, t_ns[cuts]), len(late) - 1)
        cuts = cuts[late[known] != t_ns[cuts]]
    firsts = np.append(0, cuts + 1)
    lasts = np.append(cuts, len(t_ns) - 1)
    tail = int(min(after_ns, FOREVER))
    return [(int(t_ns[a]), int(t_ns[b]) + tail) for a, b in zip(firsts, lasts, strict=True)]


def intersect(first: Sequence[Span], second: Sequence[Span]) -> list[Span]:
    """The spans in which both lie; both in order and free of overlap."""
    out: list[Span] = []
    i = j = 0
    while i < len(first) and j < len(second):
        start = max(first[i][0], second[j][0])
        stop = min(first[i][1], second[j][1])
        if start < stop:
            out.append((start, stop))
        if first[i][1] < second[j][1]:
            i += 1
        else:
            j += 1
    return out


def cut_long(spans: Sequence[Span], longest_s: float) -> list[Span]:
    """The spans, each cut into equal parts no longer than `longest_s`."""
    out: list[Span] = []
    for start, stop in spans:
        parts = max(1, int(np.ceil((stop - start) * 1e-9 / longest_s)))
        edges = [start + (stop - start) * i // parts for i in range(parts + 1)]
        out += itertools.pairwise(edges)
    return out


# -------------------------------------------------------------------------------------------- grids


def phase_ns(t_ns: IntArray, dt_ns: int) -> int:
    """Where in [0, dt) a grid best meets the samples: the circular mean of their times.

    Equally spaced samples are met exactly.
    """
    offsets = (t_ns - t_ns[0]) % dt_ns
    if not offsets.any():
        return int(t_ns[0] % dt_ns)
    angle = float(np.angle(np.exp(2j * np.pi * offsets / dt_ns).mean()))
    mean = round(angle / (2 * np.pi) * dt_ns)
    best = int(offsets[np.argmin(np.abs((offsets - mean + dt_ns // 2) % dt_ns - dt_ns // 2))])
    return int((t_ns[0] + best) % dt_ns)


def grid_in(span: Span, dt_ns: int, phase: int) -> IntArray:
    """Grid times phase + k dt inside a half-open span."""
    first = span[0] + (phase - span[0]) % dt_ns
    return np.arange(first, span[1], dt_ns, dtype=np.int64)


def linear(series: RecordedSignal, grid_ns: IntArray) -> FloatArray:
    """(N,) values at grid times, linear between samples, exact on them; the grid must lie inside."""
    if len(grid_ns) == 0:
        return np.empty(0)
    zero = grid_ns[0]
    return np.asarray(np.interp((grid_ns - zero).astype(float), (series.t_ns - zero).astype(float), series.x))


def hold(series: RecordedSignal, grid_ns: IntArray, tolerance_ns: int = 0) -> FloatArray:
    """(N,) the last value at or before each grid time (+ tolerance); NaN before the first."""
    index = np.searchsorted(series.t_ns, grid_ns + tolerance_ns, side="right") - 1
    values = series.x[np.maximum(index, 0)] if len(series.x) else np.full(len(index), np.nan)
    return np.where(index >= 0, values, np.nan)


def hold_mean(series: RecordedSignal, grid_ns: IntArray, step_ns: float) -> FloatArray:
    """(N,) the mean of the held value over the step that begins at each grid time; NaN before the first.

    A command that changes between two grid points acts from there on. Held from the next point on it would
    come late by half a step on average, and a lag and a dead time fitted to it short by as much.
    """
    if not len(series.x):
        return np.full(len(grid_ns), np.nan)
    first = hold(series, grid_ns)
    ends = grid_ns + round(step_ns)
    begun, ended = (np.searchsorted(series.t_ns, at, side="right") - 1 for at in (grid_ns, ends - 1))
    mixed = (begun >= 0) & (ended > begun)
    t, x = series.t_ns, series.x
    whole = np.append(x[:-1] * np.diff(t), 0.0)  # of samples whose time lies inside a step
    one, last = begun[mixed], ended[mixed]
    inside = np.add.reduceat(whole, np.column_stack([one + 1, last]).ravel())[::2] if len(one) else whole[:0]
    area = x[one] * (t[one + 1] - grid_ns[mixed]) + x[last] * (ends[mixed] - t[last])
    first[mixed] = (area + np.where(last > one + 1, inside, 0.0)) / round(step_ns)
    return first


def on_grid(
    series: RecordedSignal, grid_ns: IntArray, step_ns: float, tolerance_ns: int, ratio: int
) -> FloatArray:
    """A command on every `ratio`-th point of a grid, as `decimate` has states there.

    The value of each point's own stamp where stamps and points come together (`hold_tolerance_ns`), else the
    mean over the step that follows. What passed the low-pass is no stair any more: of it, too, the mean over
    the step counts, which a model that holds its inputs takes for the stair it was.

    `grid_ns`: (N,) with `ratio` points to a step, to the end of the last one's.
    """
    held = hold(series, grid_ns, tolerance_ns) if tolerance_ns else hold_mean(series, grid_ns, step_ns)
    if ratio == 1:
        return held
    if len(held) < 2 * TAPS_PER_SIDE * ratio + ratio:
        return np.empty(0)
    smoothed = np.convolve(held, lowpass(ratio), mode="valid")
    return np.asarray(np.convolve(smoothed, np.full(ratio, 1.0 / ratio), mode="valid")[::ratio])


def hold_tolerance_ns(series: RecordedSignal, grid_ns: IntArray) -> int:
    """How much later than its grid point a command may be stamped and still belong to it.

    Commands that come once a period, stamped together with the output, would otherwise fall now before,
    now after the grid point by jitter alone and be smeared over two samples. A quarter of the period
    when their distance from the grid is below a tenth of it; else 0.
    """
    if len(grid_ns) < 3 or len(series.t_ns) < 3:
        return 0
    dt = int(grid_ns[1] - grid_ns[0])
    if not 0.8 < series.period_ns / dt < 1.25:
        return 0
    inside = series.t_ns[(series.t_ns >= grid_ns[0]) & (series.t_ns <= grid_ns[-1])]
    distance = (inside - grid_ns[0] + dt // 2) % dt - dt // 2
    return dt // 4 if len(distance) and float(np.median(np.abs(distance))) < 0.1 * dt else 0


# ------------------------------------------------------------------------------------------- filter


def lowpass(ratio: int, *, cutoff: float = 0.4) -> FloatArray:
    """(2 * 5 * ratio + 1,) taps of a zero-phase low-pass for decimation by `ratio`; they sum to 1.

    A sinc with a Kaiser window: within 1 % up to 0.25 of the grid's rate, down 54 dB from 0.6 on.

    `cutoff`: of the grid's rate, where the low-pass has fallen to one half.
    """
    half = TAPS_PER_SIDE * ratio
    n = np.arange(-half, half + 1)
    taps = np.sinc(2 * cutoff * n / ratio) * np.kaiser(2 * half + 1, LOWPASS_BETA)
    return np.asarray(taps / taps.sum())


def decimate(x: FloatArray, ratio: int) -> FloatArray:
    """Every `ratio`-th sample of the low-passed x where the filter lies inside: 5 fewer at either end.

    `x` is sampled `ratio` times faster than the grid, its first sample on the grid.
    """
    if ratio == 1:
        return x
    half = TAPS_PER_SIDE * ratio
    if len(x) < 2 * half + 1:
        return np.empty(0)
    return np.asarray(np.convolve(x, lowpass(ratio), mode="valid")[::ratio])


def smooth(x: FloatArray, sigma: float) -> FloatArray:
    """Gaussian mean with `sigma` samples, its weights renormalised at the ends."""
    reach = min(int(4 * sigma) + 1, len(x) - 1)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    size = 1 << int(np.ceil(np.log2(len(x) + 2 * reach + 1)))
    spectrum = np.fft.rfft(kernel, size)
    ones = np.fft.irfft(np.fft.rfft(np.ones(len(x)), size) * spectrum, size)[reach : reach + len(x)]
    total = np.fft.irfft(np.fft.rfft(x, size) * spectrum, size)[reach : reach + len(x)]
    return np.asarray(total / ones)
