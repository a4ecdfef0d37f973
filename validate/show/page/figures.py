"""Still pictures of one channel.

Where every model of the run has its place, those of the headline are shown, and the page's buttons show the
others. Limits of axes belong to the models of the headline and to the measurement: a model that leaves them
is cut.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from flysid.dataset import FloatArray
from flysid.model.frequency.response import GOOD_COHERENCE
from flysid.model.polynomials import Z95, ComplexArray
from flysid.validate.compare.comparison import Pair
from flysid.validate.compare.words import interval_words
from flysid.validate.diagnose.bands import BandCurve
from flysid.validate.diagnose.context import Sweep
from flysid.validate.diagnose.residuals import Correlation, ResidualSpectrum
from flysid.validate.show.page.overlay import Role
from flysid.validate.show.page.svg import (
    BASELINE,
    HALF,
    THIRD,
    Axes,
    area,
    box,
    dots,
    frame,
    legend,
    line,
    owned,
    picture,
    segment,
    span,
    text,
    tick_text,
    ticks,
    whiskers,
)

NEAREST = 1.0 / 160.0
"""Of two measured points, as a share of the axis: closer ones are one dot."""
Lines = Mapping[Role, FloatArray]


def interval_bar(
    pair: Pair, reach: tuple[float, float], css: str, width: float = 220.0, scale: bool = False
) -> Markup:
    """The change in RMSE and its interval on a line; the long tick is no change; `scale`: numbered."""
    width = 340.0 if scale else width
    height = 22.0
    axes = Axes(reach, (0.0, 1.0), left=16.0, top=0.0, width=width - 32.0, height=height)
    mid = height / 2
    parts = [segment(axes.left, mid, axes.right, mid, "grid")]
    for value in ticks(*reach, count=6) if scale else ():
        at = float(axes.px(value))
        parts.append(segment(at, mid - 4, at, mid + 4, "axis"))
        sign = "+" if value > 0 else ""
        parts.append(text(at, height + 12, f"{sign}{tick_text(value)} %", anchor="middle"))
    zero = float(axes.px(0.0))
    parts.append(segment(zero, 2, zero, height - 2, "zero"))
    if pair.ci95 is not None and pair.change_pct is not None:
        low, high = (float(np.clip(axes.px(v), axes.left, axes.right)) for v in pair.ci95)
        parts.append(segment(low, mid, max(high, low + 1), mid, f"ci {css}"))
    if pair.change_pct is not None:
        at = float(np.clip(axes.px(pair.change_pct), axes.left, axes.right))
        parts.append(segment(at, mid, at, mid, f"ci-dot {css}"))
    label = f"Change in RMSE {interval_words(pair)} percent" if pair.ci95 else "No interval"
    return picture(width, height + 16.0 if scale else height, parts, label, "scaled" if scale else "interval")


@dataclass(frozen=True, eq=False)
class Points:
    """A measured response, (F,) each; `spread`: half the 95 % interval of ln gain and of the phase, rad."""

    hz: FloatArray
    response: ComplexArray
    coherence: FloatArray
    spread: FloatArray

    @classmethod
    def of(cls, spectrum: ResidualSpectrum) -> Points:
        """Those of a spectrum along held-out flights."""
        return cls(spectrum.hz, spectrum.response, spectrum.coherence, Z95 * spectrum.relative_error)


def bode(
    points: Points | None,
    models: Mapping[Role, Sequence[BandCurve]],
    hz: FloatArray,
    unit: str,
    label: str,
    trusted_hz: tuple[float, float] | None = None,
) -> Markup:
    """Gain, phase and coherence; `models` gives every model one curve per rule, with its band.

    The axes hold the models of the headline and every measured point of enough coherence. `trusted_hz` is
    shaded.
    """
    shown = [c.response for role, own in models.items() if role.shown for c in own]
    gains = [_db(r) for r in shown]
    phases = [_degrees(r) for r in shown]
    measured = None if points is None else _Measured.of(points, hz, phases)
    if measured is not None:
        gains.append(measured.db[measured.trusted])
    low, high = span(*gains)
    width = HALF - 60
    x = (float(hz[0]), float(hz[-1]))
    gain = Axes(x, (max(low, high - 80), high), width=width, height=150, log_x=True)
    turned = [*phases, *([] if measured is None else [measured.degrees[measured.trusted]])]
    phase = Axes(x, span(*turned, around=-90.0), top=214, width=width, height=100, log_x=True)
    parts = [
        frame(gain, f"gain, dB ({unit})", x_ticks=False),
        frame(phase, "phase, deg", x_ticks=False),
    ]
    bottom = Axes(x, (0.0, 1.0), top=344, width=width, height=44, log_x=True)
    if trusted_hz is not None:
        ends = tuple(gain.px(np.array(trusted_hz)))
        parts += [box(ends, (axes.top, axes.bottom), "band") for axes in (gain, phase)]
    parts.append(frame(bottom, "coherence", "frequency, Hz", y_count=1))
    if measured is not None:
        parts += _empirical(measured, gain, phase, bottom)
    banded: list[ComplexArray] = []  # two models of one response, of which one took the other's parameters
    for role, own in models.items():
        drawn: list[Markup] = []
        for i, curve in enumerate(own):
            stem = role.css if len(own) == 1 else f"r{i % 8 + 1}"
            rule = f"rule {stem} dashed" if role.css == BASELINE else f"rule {stem}"  # the baseline is dashed
            style = role.css if len(own) == 1 else rule if role.shown else f"{rule} other"
            if any(np.allclose(curve.response, other, atol=0.0) for other in banded):
                curve = replace(curve, band=None)
            elif curve.band is not None:
                banded.append(curve.response)
            drawn += _curve(curve, hz, (gain, phase), stem, style)
        parts.append(owned(role.model, drawn, shown=role.shown))
    return picture(HALF, 424, parts, label)


def _db(response: ComplexArray) -> FloatArray:
    return np.asarray(20 * np.log10(np.maximum(np.abs(response), 1e-12)))


def _degrees(response: ComplexArray) -> FloatArray:
    return np.asarray(np.unwrap(np.angle(response)) * 180 / np.pi)


def _curve(curve: BandCurve, hz: FloatArray, axes: tuple[Axes, Axes], stem: str, style: str) -> list[Markup]:
    """Gain and phase of one rule over its band; every third point of a band is enough."""
    gain, phase = axes
    degrees = _degrees(curve.response)
    parts = []
    if curve.band is not None:
        few = slice(None, None, 3)
        b = curve.band
        db = [20 * np.log10(np.maximum(v, 1e-12))[few] for v in (b.low, b.high)]
        turned = [(degrees + v * 180 / np.pi)[few] for v in (b.turn_low, b.turn_high)]
        for one, (low, high) in ((gain, db), (phase, turned)):
            if np.isfinite(low).all() and np.isfinite(high).all():
                ends = (np.clip(low, *one.y), np.clip(high, *one.y))
                parts.append(area(one, hz[few], *ends, f"sure {stem}"))
    parts.append(line(gain, hz, _db(curve.response), style))
    parts.append(line(phase, hz, degrees, style))
    return parts


@dataclass(frozen=True, eq=False)
class _Measured:
    """Points of a measured response that stand apart on the page; (F,) each.

    `spread`: half the 95 % interval of the gain over the gain, and of the phase in rad.
    `trusted`: the coherence is high enough.
    """

    hz: FloatArray
    db: FloatArray
    degrees: FloatArray
    coherence: FloatArray
    spread: FloatArray
    trusted: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, s: Points, hz: FloatArray, phases: Sequence[FloatArray]) -> _Measured:
        """Within the range of `hz`; the phase on the turn that is nearest to the models'."""
        keep = np.flatnonzero((s.hz >= hz[0]) & (s.hz <= hz[-1]))
        keep = keep[_apart(np.log(s.hz[keep] / hz[0]) / np.log(hz[-1] / hz[0]))]
        degrees = np.angle(s.response[keep]) * 180 / np.pi
        if phases:
            near = np.mean([np.interp(s.hz[keep], hz, p) for p in phases], axis=0)
            degrees = degrees + 360.0 * np.round((near - degrees) / 360.0)
        coherence = s.coherence[keep]
        trusted = coherence >= GOOD_COHERENCE
        return cls(s.hz[keep], _db(s.response[keep]), degrees, coherence, s.spread[keep], trusted)


def _apart(places: FloatArray) -> list[int]:
    """Indices of rising places (shares of the axis) that are at least `NEAREST` from the one before."""
    found: list[int] = []
    for i, place in enumerate(places):
        if not found or place - places[found[-1]] >= NEAREST:
            found.append(i)
    return found


def _empirical(m: _Measured, gain: Axes, phase: Axes, bottom: Axes) -> list[Markup]:
    """Measured points with their whiskers; faint where the coherence is too low."""
    parts = [area(bottom, m.hz, np.zeros(len(m.hz)), m.coherence, "fill")]
    low_db = m.db + 20 * np.log10(np.maximum(1.0 - m.spread, 1e-2))
    high_db = m.db + 20 * np.log10(1.0 + m.spread)
    turn = m.spread * 180 / np.pi
    for axes, values, low, high in (
        (gain, m.db, low_db, high_db),
        (phase, m.degrees, m.degrees - turn, m.degrees + turn),
    ):
        inside = (values > axes.y[0]) & (values < axes.y[1])
        good = inside & m.trusted
        bottom_end = np.clip(low, *axes.y)[good]
        top_end = np.clip(high, *axes.y)[good]
        parts.append(whiskers(axes, m.hz[good], bottom_end, top_end, "whisker thin"))
        parts.append(dots(axes, m.hz[inside & ~m.trusted], values[inside & ~m.trusted], "dot faint"))
        parts.append(dots(axes, m.hz[good], values[good], "dot"))
    return parts


def coverage(train: FloatArray | None, test: FloatArray, words: tuple[str, str]) -> Markup:
    """Histograms of one signal: grey training, line held-out, red outside the range of training."""
    everything = test if train is None else np.concatenate([train, test])
    low, high = span(everything, pad=0.03)
    edges = np.linspace(low, high, 33)
    held, _ = np.histogram(test, edges)
    share = held / max(1, held.sum())
    parts: list[Markup] = []
    tallest = float(share.max())
    if train is not None:
        seen, _ = np.histogram(train, edges)
        seen_share = seen / max(1, seen.sum())
        tallest = max(tallest, float(seen_share.max()))
    axes = Axes((low, high), (0.0, 1.1 * tallest), left=12, top=8, width=THIRD - 24, height=96)
    parts.append(frame(axes, "", words[0], y_count=0))
    if train is not None:
        for edge, limit in ((low, float(train.min())), (high, float(train.max()))):
            ends = (float(axes.px(edge)), float(axes.px(limit)))
            parts.append(box(ends, (axes.top, axes.bottom), "outside"))
        for i, value in enumerate(seen_share):
            ends = (float(axes.px(edges[i])) + 0.5, float(axes.px(edges[i + 1])) - 0.5)
            parts.append(box(ends, (axes.bottom, float(axes.py(value))), "fill"))
    parts.append(line(axes, np.repeat(edges, 2)[1:-1], np.repeat(share, 2), "heldout"))
    return picture(THIRD, 142, parts, words[1])


def sweep_figure(sweep: Sweep, unit: str) -> Markup:
    """Error over the number of rules, with one standard error."""
    x = np.array(sweep.rules, dtype=np.float64)
    error = np.array(sweep.error)
    spread = np.array(sweep.spread)
    limits = [error - spread, error + spread]
    if sweep.linear is not None:
        limits.append(np.array([sweep.linear[0] - sweep.linear[1], sweep.linear[0] + sweep.linear[1]]))
    axes = Axes(
        (float(x.min()) - 0.5, float(x.max()) + 0.5), span(*limits, pad=0.22), width=HALF - 60, height=120
    )
    parts = [frame(axes, f"RMSE, {sweep.unit or unit}", "number of rules", whole=True)]
    if sweep.linear is not None:
        mean, sd = sweep.linear
        parts.append(
            box((axes.left, axes.right), tuple(axes.py(np.array([mean - sd, mean + sd]))), "arx-band")
        )
        parts.append(line(axes, np.array(axes.x), np.array([mean, mean]), "arx"))
        parts.append(text(axes.right - 4, float(axes.py(mean)) - 4, "linear", anchor="end"))
    known = spread > 0.0
    for xi, e, s in zip(x[known], error[known], spread[known], strict=True):
        parts.append(line(axes, np.array([xi, xi]), np.array([e - s, e + s]), "whisker"))
    parts += [line(axes, x, error, "ts"), dots(axes, x, error, "bead")]
    if sweep.chosen in sweep.rules:
        i = sweep.rules.index(sweep.chosen)
        parts.append(dots(axes, x[i : i + 1], error[i : i + 1], "ring"))
        beside = np.delete(error[max(0, i - 1) : i + 2], min(i, 1))
        below = (
            beside.sum() > len(beside) * error[i]
        )  # away from the lines to its neighbours, past the whisker
        dot, low, high = (float(axes.py(e)) for e in (error[i], error[i] - spread[i], error[i] + spread[i]))
        place = float(axes.px(x[i])), max(dot + 20.0, low + 12.0) if below else min(dot - 12.0, high - 5.0)
        parts.append(text(*place, f"chosen: {sweep.chosen}", anchor="middle"))
    return picture(HALF, 186, parts, f"Error over the number of rules; {sweep.chosen} chosen")


def key(items: Sequence[tuple[str, str]], label: str) -> Markup:
    """A legend by itself."""
    width = sum(38 + 6.2 * len(name) for _, name in items)
    return picture(max(width, 60.0), 16, [legend(items, 2, 12)], label, "key")


def find_reach(
    values: Lines, *, measured: FloatArray | None = None, around: float | None = None
) -> tuple[float, float]:
    """Limits of the models that are shown and of what was measured; the others may go half as far beyond."""
    seen = [] if measured is None else [measured]
    own = [v for role, v in values.items() if role.shown]
    low, high = span(*own, *seen, around=around)
    more = 0.5 * (high - low)
    all_low, all_high = span(*values.values(), *seen, around=around)
    return max(all_low, low - more), min(all_high, high + more)


def _each(axes: Axes, x: FloatArray, values: Lines) -> Iterator[Markup]:
    for role, y in values.items():
        yield owned(role.model, [line(axes, x, y, role.css)], shown=role.shown)


def step_figure(t: FloatArray, values: Lines, unit: str, label: str) -> Markup:
    """(N,) change of the output after a step of the input at t = 0, of every model."""
    axes = Axes((float(t[0]), float(t[-1])), find_reach(values, around=0.0), width=HALF - 60, height=150)
    zero = float(axes.py(0.0))
    parts = [frame(axes, unit, "time after the step, s"), segment(axes.left, zero, axes.right, zero, "axis")]
    return picture(HALF, 216, [*parts, *_each(axes, t, values)], label)


def static_map(rests: FloatArray, levels: FloatArray, steady: Lines, words: tuple[str, str, str]) -> Markup:
    """Measured equilibria (M, 2) as dots, each model's steady output over `levels`; words: x, y, label."""
    limits = find_reach(steady, measured=rests[:, 1])
    axes = Axes(span(rests[:, 0], levels), limits, width=HALF - 60, height=170)
    parts = [frame(axes, words[1], words[0]), dots(axes, rests[:, 0], rests[:, 1], "dot")]
    return picture(HALF, 234, [*parts, *_each(axes, levels, steady)], words[2])


def pole_map(found: Mapping[Role, Sequence[tuple[ComplexArray, ComplexArray]]], label: str) -> Markup:
    """Poles (crosses) and zeros (circles) in z on equal scales, and the unit circle; upper half alone, as the
    lower mirrors it."""
    poles = [z for role, rules in found.items() if role.shown for z, _ in rules]
    points = np.concatenate([*poles, np.ones(1)])
    points = points[np.abs(points) < 2.0]
    width = HALF - 60
    height = 170.0
    wide = max(float(np.ptp(points.real)), float(np.abs(points.imag).max()) * width / height, 0.05) * 1.15
    middle = (float(points.real.min()) + float(points.real.max())) / 2
    tall = wide * height / width
    axes = Axes(
        (middle - wide / 2, middle + wide / 2), (-0.06 * tall, 0.94 * tall), width=width, height=height
    )
    turn = np.linspace(0.0, np.pi, 721)
    x = np.cos(turn)
    y = np.sin(turn)
    inside = (x >= axes.x[0]) & (x <= axes.x[1]) & (y <= axes.y[1])
    parts = [frame(axes, "imaginary part of z", "real part of z")]
    zero = float(axes.py(0.0))
    parts.append(segment(axes.left, zero, axes.right, zero, "axis"))
    parts.append(line(axes, np.where(inside, x, np.nan), np.where(inside, y, np.nan), "circle"))
    for role, rules in found.items():
        own = []
        for i, (own_poles, zeros) in enumerate(rules):
            colour = role.css.split()[-1] if len(rules) == 1 else f"r{i % 8 + 1}"
            own.append(_marks(axes, own_poles, colour, cross=True))
            own.append(_marks(axes, zeros, colour, cross=False))
        parts.append(owned(role.model, own, shown=role.shown))
    return picture(HALF, 236, parts, label)


def _marks(axes: Axes, z: ComplexArray, colour: str, *, cross: bool) -> Markup:
    """Crosses or circles at those of `z` that lie in the picture."""
    seen = z[(z.imag >= -1e-9) & (z.real >= axes.x[0]) & (z.real <= axes.x[1]) & (z.imag <= axes.y[1])]
    d = ""
    for px, py in zip(axes.px(seen.real), axes.py(seen.imag), strict=True):
        d += (
            f"M{px - 4:.1f} {py - 4:.1f}l8 8m0 -8l-8 8"
            if cross
            else f"M{px - 4.5:.1f} {py:.1f}a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0 -9 0"
        )
    return Markup('<path d="{}" class="mark {}"/>').format(d, colour)


def histogram(residuals: Lines, words: tuple[str, str], *, bins: int = 41) -> Markup:
    """Share of the one-step residuals of every model in each of `bins` bins; `words`: axis, label.

    `bins`: of the histogram: an odd number has a bin about zero.
    """
    own = np.concatenate([r for role, r in residuals.items() if role.shown])
    own = own[np.isfinite(own)]
    reach = float(np.percentile(np.abs(own), 99.5)) if len(own) else 1.0
    edges = np.linspace(-1.0, 1.0, bins + 1) * (reach or 1.0)
    shares = {}
    for role, r in residuals.items():
        count, _ = np.histogram(np.clip(r[np.isfinite(r)], edges[0], edges[-1]), edges)
        shares[role] = np.repeat(100.0 * count / max(1, count.sum()), 2)
    low, high = find_reach(shares, around=0.0)
    axes = Axes((edges[0], edges[-1]), (max(low, 0.0), high), width=HALF - 60, height=120)
    parts = [frame(axes, "share of samples, %", words[0])]
    return picture(HALF, 186, [*parts, *_each(axes, np.repeat(edges, 2)[1:-1], shares)], words[1])


def residual_spectrum(hz: FloatArray, densities: Lines, unit: str, label: str) -> Markup:
    """Power spectral density of the one-step residuals of every model, dB; flat where they are white."""
    db = {role: 10.0 * np.log10(np.maximum(d, 1e-300)) for role, d in densities.items()}
    axes = Axes((float(hz[0]), float(hz[-1])), find_reach(db), width=HALF - 60, height=120, log_x=True)
    parts = [frame(axes, unit, "frequency, Hz")]
    return picture(HALF, 186, [*parts, *_each(axes, hz, db)], label)


def correlogram(tests: Mapping[Role, Correlation], dt_s: float, label: str) -> Markup:
    """Correlation of every model against lag in seconds, with its 99 % band."""
    shown = [c for role, c in tests.items() if role.shown] or list(tests.values())
    first = shown[0]
    largest = max(float(np.max(np.abs(c.rho), initial=0.0)) for c in shown)
    peak = max(0.25, min(1.0, 1.15 * largest), 1.3 * min(max(c.band for c in shown), 0.77))
    lowest = min(float(np.min(c.rho, initial=0.0)) for c in shown)
    low = -peak if lowest < -0.3 * peak else -0.5 * peak
    seconds = first.lags * dt_s
    left = 0.0 if seconds[0] > 0 else float(seconds[0])
    half = 0.5 * dt_s
    axes = Axes((left - half, float(seconds[-1]) + half), (low, peak), top=10.0, width=HALF - 56, height=120)
    words = "lag, s (positive: the input leads)" if seconds[0] < 0 else "lag, s"
    parts = [frame(axes, "", words, y_count=5)]
    parts.append(segment(axes.left, float(axes.py(0.0)), axes.right, float(axes.py(0.0)), "axis"))
    for role, c in tests.items():
        band = box((axes.left, axes.right), (float(axes.py(c.band)), float(axes.py(-c.band))), "band")
        parts.append(owned(role.model, [band], shown=role.shown))
    for role, c in tests.items():
        beads = dots(axes, seconds, c.rho, f"tick {role.css}")
        parts.append(owned(role.model, [line(axes, seconds, c.rho, role.css), beads], shown=role.shown))
    return picture(HALF, 168, parts, label)
