"""The terms of a blackbox log's controller, computed again step by step from its header and its gyro.

Logs keep every second, eighth or sixteenth loop. Setpoint, rate and throttle are interpolated to the loops in
between, the law is stepped through all of them, and its terms are read off at the rows of the log. Sums begin
at what the log recorded, anew behind every gap.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from flysid.compiling import njit
from flysid.dataset import FloatArray
from flysid.loops.betaflight import BetaflightLaw
from flysid.loops.law_parts import Means
from flysid.loops.stages import filters_of, sections
from flysid.spectra.running import filter_sample

LEVELS = 101
"""Of the throttle, at which moving filters are set: the firmware rounds it to hundredths."""
MOST_LOOPS_BETWEEN = 1000
"""Rows farther apart stand on two sides of a gap."""
HIGHPASS_HZ = 15.0
"""Of the older anti-gravity's throttle."""
SLOPE_I, SLOPE_P = 0.34, 0.0034
"""What the newer anti-gravity adds to I, and to P's factor, for each unit of its gain."""
SMOOTH_HZ, SMOOTH_I = 3.0, 21.586988
"""Of the anti-gravity between them: of its slower part, and what I gains for a unit."""
FREE_RATE = 50.0
"""deg/s of the setpoint up to which anti-gravity raises P fully."""


@dataclass(frozen=True, eq=False)
class Rows:
    """What the controller saw, row by row of a log.

    `loop`: (N,) its number.
    `setpoint`, `weighed`, `rate`: (N,) deg/s; `weighed` is what the derivative takes of the setpoint.
    `throttle`: (N,) 0 to 1, of the kind that the law goes by.
    `asked`: (N,) share of the motors' range that the axes demanded.
    `faster`: (N,) factor of the integral while the throttle moves in steps.
    `carried`: (N,) thousandths a second that turns of the body carry over from the other axes' integrals.
    `slope`: (N,) deg/s^2 of the setpoint, as the F term has it.
    `integral`: (N,) the recorded I.
    `resolution`: of setpoint and rate, deg/s.
    """

    loop: FloatArray
    setpoint: FloatArray
    weighed: FloatArray
    rate: FloatArray
    throttle: FloatArray
    asked: FloatArray
    faster: FloatArray
    carried: FloatArray
    slope: FloatArray
    integral: FloatArray
    resolution: float = 1.0


@dataclass(frozen=True, eq=False)
class Rebuilt:
    """Terms at the rows of a log, (N,) thousandths, and what moved in the law, on average."""

    p: FloatArray
    i: FloatArray
    d: FloatArray
    means: Means


def rebuild(law: BetaflightLaw, rows: Rows, step_s: float) -> Rebuilt:
    """The terms P, I and D. `step_s`: of the loop as it ran; the law's own step is that of its filters."""
    whole = np.zeros((3, len(rows.loop)))
    pieces = _pieces(rows.loop)
    squares = np.sum([_rebuild_piece(law, rows, own, step_s, whole) for own in pieces], axis=0)
    shares = [float(over / under) if under > 0.0 else 1.0 for over, under in squares[:3]]
    cut = float(squares[3][0] / squares[3][1]) if law.moving else None
    return Rebuilt(whole[0], whole[1], whole[2], Means(shares[0], shares[1], shares[2], cut))


def _pieces(loop: FloatArray) -> list[slice]:
    """Stretches of rows whose loops follow each other."""
    steps = np.diff(loop)
    edges = np.flatnonzero((steps <= 0.0) | (steps > MOST_LOOPS_BETWEEN)) + 1
    return [slice(a, b) for a, b in itertools.pairwise([0, *edges, len(loop)]) if b - a > 1]


def _rebuild_piece(
    law: BetaflightLaw, rows: Rows, own: slice, step_s: float, whole: FloatArray, *, most_loops: int = 1 << 16
) -> FloatArray:
    """(4, 2) sums whose quotients are the means; the terms of a stretch are written to `whole` (3, N).

    `most_loops`: held at once: a log of every sixteenth loop has sixteen times its rows of them.
    """
    loop = rows.loop[own]
    fixed = (
        _numbers(law, step_s),
        _by_throttle(law),
        sections(law.p_filters, (0.0, 0.0), law.step_s),
        *_boost_numbers(law),
        _gravity(law),
    )
    begin = own.start
    first_throttle = min(max(float(rows.throttle[begin]), 0.0), 1.0)
    first = np.array(
        [
            rows.weighed[begin] - rows.rate[begin],
            rows.setpoint[begin],
            first_throttle,
            first_throttle,
            0.0,
            0.0,
            0.0,
            rows.integral[begin],
        ]
    )
    state = (first, *_rest(law.slope_filtered, float(rows.rate[begin]), *fixed[1:3], *fixed[4:6]))
    sums = np.zeros((4, 2))
    marks = np.searchsorted(loop, np.arange(loop[0], loop[-1], most_loops))
    for at, end in itertools.pairwise([*np.unique(marks).tolist(), len(loop)]):
        around = slice(
            begin + at, begin + min(end + 1, len(loop))
        )  # with the row that the last loops lead to
        terms, cuts = _step_rows(law, rows, around, end < len(loop), state, sums, fixed)
        whole[:, begin + at : begin + end] = terms[:, (loop[at:end] - loop[at]).astype(np.int64)]
        sums[3] += cuts
    return sums


def _step_rows(
    law: BetaflightLaw,
    rows: Rows,
    own: slice,
    goes_on: bool,
    state: tuple[FloatArray, ...],
    sums: FloatArray,
    fixed: tuple[FloatArray, ...],
) -> tuple[FloatArray, tuple[float, int]]:
    """(3, n) terms of every loop of some rows; the moving cut-offs' sum and number.

    `goes_on`: the last row is the first of the next call.
    `state`, `sums`: changed in place.
    """
    loop = rows.loop[own]
    every = np.arange(loop[0], loop[-1] + (0.0 if goes_on else 1.0))

    def at(values: FloatArray) -> FloatArray:
        return np.interp(every, loop, values[own])

    throttle = np.clip(at(rows.throttle), 0.0, 1.0)
    cuts = law.moving.cutoff(throttle) if law.moving else np.zeros(0)
    terms = _step(
        at(rows.setpoint),
        at(rows.weighed),
        at(rows.rate),
        at(rows.slope),
        law.kept(1000.0 + 1000.0 * throttle),
        at(rows.asked),
        at(rows.faster),
        at(rows.carried) if law.rotates else np.zeros(len(every)),
        throttle,
        law.slope_filtered,
        law.freezes,
        state,
        sums,
        *fixed,
    )
    return terms, (float(cuts.sum()), max(len(cuts), 1))


def _rest(
    whole: bool,
    rate: float,
    d_rows: FloatArray,
    p_rows: FloatArray,
    range_rows: FloatArray,
    smooth_rows: FloatArray,
) -> tuple[FloatArray, ...]:
    """States of the filters of D, of P, and of D's growth, before the first loop."""
    found = tuple(
        np.zeros((count, 2)) for count in (d_rows.shape[1], *map(len, (p_rows, range_rows, smooth_rows)))
    )
    _settle(0.0 if whole else rate, d_rows[0], found[0])
    _settle(1.0, smooth_rows, found[3])
    return found


def _numbers(law: BetaflightLaw, step_s: float) -> FloatArray:
    """What the law is made of, in the order of `_step`."""
    of_d, of_i = (law.step_s if stated else step_s for stated in law.stated_steps)
    p, d = (float(term in law.tpa_terms) for term in "PD")
    relax = law.relax
    share = _pt1(relax.cutoff_hz, law.step_s) if relax else 0.0
    threshold = relax.threshold if relax else np.inf
    return np.array(
        [law.p, law.i, law.d, of_d, of_i, law.windup, law.largest_i, share, threshold, p, d, law.step_s]
    )


def _pt1(hz: float, step_s: float) -> float:
    """The share of the way that a first-order low-pass goes in a step."""
    return float(sections(((1, hz),), (0.0, 0.0), step_s)[0, 0])


def _by_throttle(law: BetaflightLaw) -> FloatArray:
    """(L, S, 5) the derivative's filters at every level of the throttle; one where they do not move."""
    if law.moving is None:
        return sections(law.filters, law.notch, law.step_s)[None]
    cuts = law.moving.cutoff(np.linspace(0.0, 1.0, LEVELS))
    return np.array([sections(law.filters_at(cut), law.notch, law.step_s) for cut in cuts])


def _boost_numbers(law: BetaflightLaw) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Most, by rate and by setpoint of D's growth, and its filters."""
    if law.boost is None:
        none = np.zeros((0, 5))
        return np.array([1.0, 0.0, 0.0]), none, none
    own = law.boost
    filters = (sections(f, (0.0, 0.0), law.step_s) for f in (own.range_filters, own.smooth_filters))
    ranged, smooth = filters
    return np.array([own.most, own.by_rate, own.by_setpoint]), ranged, smooth


def _gravity(law: BetaflightLaw) -> FloatArray:
    """Kind (1 high-pass, 2 slope, 3 smoothed; 0 none), shares of first-order steps, what I and P gain."""
    own = law.faster
    if own is None:
        return np.zeros(6)
    high, smooth = (_pt1(hz, law.step_s) for hz in (HIGHPASS_HZ, SMOOTH_HZ))
    if own.kind == "highpass":
        return np.array([1.0, high, 0.0, law.i * 0.01 * max(own.gain - 1000.0, 0.0), 0.0, 0.0])
    if own.kind == "smoothed":
        return np.array(
            [3.0, high, smooth, SMOOTH_I * 0.01 * own.gain, SMOOTH_I * 0.05 * own.gain, 0.02 * own.gain]
        )
    slow = _pt1(filters_of("pt2", own.cutoff_hz)[0][1], law.step_s)
    return np.array([2.0, slow, 0.0, SLOPE_I * own.gain, 0.0, SLOPE_P * own.gain * own.p / 100.0])


@njit(cache=True)
def _settle(x: Any, rows: Any, states: Any) -> None:
    """States of biquads that have seen x for ever."""
    for j in range(rows.shape[0]):
        b0, b1, b2, a1, a2 = rows[j]
        out = x * (b0 + b1 + b2) / (1.0 + a1 + a2)
        states[j, 1] = b2 * x - a2 * out
        states[j, 0] = b1 * x - a1 * out + states[j, 1]
        x = out


@njit(cache=True)
def _step(  # type: ignore[no-untyped-def]
    setpoint,
    weighed,
    rate,
    slope,
    kept,
    asked,
    faster,
    carried,
    throttle,
    whole,
    frozen,
    state,
    sums,
    numbers,
    d_rows,
    p_rows,
    boost,
    range_rows,
    smooth_rows,
    gravity,
):
    """(3, n) P, I, D of every loop, from a state that is left for the next ones.

    To the rows P, I, D of `sums` are added the products with the plain term, and its squares.
    """
    p, i, d, step_d, step_i, windup, largest_i, relax_share, threshold, tpa_p, tpa_d, step_s = numbers
    most, by_rate, by_setpoint = boost
    kind, share, slow_share, more_i, slow_i, more_p = gravity
    n = setpoint.size
    terms = np.zeros((3, n))
    levels = d_rows.shape[0]
    carried_on, d_states, p_states, range_states, smooth_states = state
    before, low, low_throttle, last_throttle, quick, quicker, slow, total = carried_on
    for k in range(n):
        error = setpoint[k] - rate[k]
        if kind == 1.0 or kind == 3.0:
            low_throttle += share * (throttle[k] - low_throttle)
            quick = abs(throttle[k] - low_throttle)
            room = max(0.5 - throttle[k], 0.0) * (0.5 if low_throttle < throttle[k] else 1.0)
            slow += slow_share * (room * quick - slow)
        elif kind == 2.0:
            room = 1.0 - throttle[k]
            moved = abs(throttle[k] - last_throttle) / step_s * room * room
            if throttle[k] > last_throttle:
                moved *= 0.5 * room
            quicker += share * (moved - quicker)
            quick += share * (quicker - quick)
        shrunk = kept[k] if tpa_p > 0.0 else 1.0
        plain = filter_sample(p * error, p_rows, p_states) if p_rows.shape[0] else p * error
        lifted = slow if kind == 3.0 else quick
        raised = 1.0 + more_p * lifted / max(abs(setpoint[k]) / FREE_RATE, 1.0)
        terms[0, k] = plain * shrunk * raised
        sums[0, 0] += terms[0, k] * plain
        sums[0, 1] += plain * plain
        relaxed = 1.0
        if relax_share > 0.0:
            low += relax_share * (setpoint[k] - low)
            relaxed = max(0.0, 1.0 - abs(setpoint[k] - low) / threshold)
        if windup < 1.0:
            relaxed *= min(max((1.0 - asked[k]) / (1.0 - windup), 0.0), 1.0)
        gained = i + more_i * quick + slow_i * slow
        more = total + gained * faster[k] * step_i * error * relaxed
        more = min(max(more, -largest_i), largest_i)
        if frozen and asked[k] >= 1.0 and abs(more) >= abs(total):
            more = total
        more += carried[k] * step_i
        simple = i * step_i * error
        sums[1, 0] += (more - total) * simple
        sums[1, 1] += simple * simple
        total = more
        terms[1, k] = total
        level = int(np.rint(throttle[k] * (levels - 1)))
        seen = weighed[k] - (rate[k] if whole else filter_sample(rate[k], d_rows[level], d_states))
        turn = (seen - before) / step_d
        before = seen
        if whole:
            turn = filter_sample(turn, d_rows[level], d_states)
        grown = 1.0
        if most > 1.0:
            own = max(
                abs(filter_sample(turn, range_rows, range_states)) * by_rate, abs(slope[k]) * by_setpoint
            )
            grown = min(filter_sample(1.0 + (most - 1.0) * own, smooth_rows, smooth_states), most)
        shrunk = kept[k] if tpa_d > 0.0 else 1.0
        terms[2, k] = d * turn * grown * shrunk
        sums[2, 0] += terms[2, k] * d * turn
        sums[2, 1] += d * turn * d * turn
        last_throttle = throttle[k]
    carried_on[:] = np.array([before, low, low_throttle, last_throttle, quick, quicker, slow, total])
    return terms
