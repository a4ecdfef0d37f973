"""Still pictures of one channel: residual tests, frequency response, static map, coverage, rule count."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from flysid.dataset import FloatArray
from flysid.validate.bands import Curve
from flysid.validate.comparison import Pair
from flysid.validate.report.context import Sweep
from flysid.validate.report.svg import (
    Axes,
    area,
    box,
    dots,
    frame,
    legend,
    line,
    picture,
    segment,
    span,
    stems,
    text,
    tick_text,
    ticks,
)
from flysid.validate.residuals import Correlation, Spectrum
from flysid.validate.words import interval_words

HALF = 470.0
THIRD = 310.0


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


def correlogram(c: Correlation, dt_s: float, css: str, label: str) -> Markup:
    """Correlation against lag in seconds, with its 99 % band."""
    peak = max(0.25, min(1.0, 1.15 * float(np.max(np.abs(c.rho), initial=0.0))), 1.3 * c.band)
    low = -peak if float(np.min(c.rho, initial=0.0)) < -0.3 * peak else -0.5 * peak
    seconds = c.lags * dt_s
    left = 0.0 if seconds[0] > 0 else float(seconds[0])
    half = 0.5 * dt_s
    axes = Axes(
        (left - half, float(seconds[-1]) + half), (low, peak), top=10.0, width=HALF - 56, height=110.0
    )
    negative = seconds[0] < 0
    parts = [
        box((axes.left, axes.right), (float(axes.py(c.band)), float(axes.py(-c.band))), "band"),
        frame(axes, "", "lag, s (positive: the input leads)" if negative else "lag, s", y_count=5),
        segment(axes.left, float(axes.py(0.0)), axes.right, float(axes.py(0.0)), "axis"),
        stems(axes, seconds, c.rho, f"stem {css}"),
    ]
    return picture(HALF, 158, parts, label)


def bode(
    empirical: Spectrum | None,
    models: Mapping[str, Sequence[Curve]],
    hz: FloatArray,
    unit: str,
    label: str,
) -> Markup:
    """Gain, phase and coherence; `models` maps a CSS class stem to one curve per rule, with its band."""
    curves = [c.response for own in models.values() for c in own]
    gain_db = [20 * np.log10(np.maximum(np.abs(r), 1e-12)) for r in curves]
    phases = [np.unwrap(np.angle(r)) * 180 / np.pi for r in curves]
    shown = [*gain_db]
    if empirical is not None:
        trusted = empirical.coherence > 0.5
        shown.append(20 * np.log10(np.maximum(np.abs(empirical.response[trusted]), 1e-12)))
    low, high = span(*shown)
    width = HALF - 60
    x = (float(hz[0]), float(hz[-1]))
    gain = Axes(x, (max(low, high - 80), high), width=width, height=150, log_x=True)
    phase = Axes(x, span(*phases, around=-90.0), top=214, width=width, height=100, log_x=True)
    parts = [
        frame(gain, f"gain, dB ({unit})", x_ticks=False),
        frame(phase, "phase, deg", x_ticks=False),
    ]
    bottom = Axes(x, (0.0, 1.0), top=344, width=width, height=44, log_x=True)
    parts.append(frame(bottom, "coherence", "frequency, Hz", y_count=1))
    if empirical is not None:
        parts += _empirical(empirical, gain, phase, bottom, phases)
    for css, own in models.items():
        for i, curve in enumerate(own):
            stem = css if len(own) == 1 else f"r{i % 8 + 1}"
            rule = f"rule {stem} dashed" if css == "arx" else f"rule {stem}"  # the baseline is dashed
            parts += _curve(curve, hz, (gain, phase), stem, css if len(own) == 1 else rule)
    return picture(HALF, 424, parts, label)


def _curve(curve: Curve, hz: FloatArray, axes: tuple[Axes, Axes], stem: str, style: str) -> list[Markup]:
    """Gain and phase of one rule over its band; every third point of a band is enough."""
    gain, phase = axes
    degrees = np.unwrap(np.angle(curve.response)) * 180 / np.pi
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
    parts.append(line(gain, hz, 20 * np.log10(np.maximum(np.abs(curve.response), 1e-12)), style))
    parts.append(line(phase, hz, degrees, style))
    return parts


def _empirical(
    s: Spectrum, gain: Axes, phase: Axes, bottom: Axes, phases: Sequence[FloatArray]
) -> list[Markup]:
    """Measured points; faint where the coherence is below one half."""
    inside = (s.hz >= gain.x[0]) & (s.hz <= gain.x[1])
    db = 20 * np.log10(np.maximum(np.abs(s.response), 1e-12))
    degrees = np.angle(s.response) * 180 / np.pi
    if phases:
        near = np.mean([np.interp(s.hz, np.geomspace(*gain.x, len(p)), p) for p in phases], axis=0)
        degrees = degrees + 360.0 * np.round((near - degrees) / 360.0)
    parts = [area(bottom, s.hz[inside], np.zeros(int(inside.sum())), s.coherence[inside], "fill")]
    parts += _empirical_band(s, gain, phase, degrees)
    for css, chosen in (("dot faint", s.coherence <= 0.5), ("dot", s.coherence > 0.5)):
        keep = inside & chosen & (db > gain.y[0]) & (db < gain.y[1])
        parts.append(dots(gain, s.hz[keep], db[keep], css))
        seen = keep & (degrees > phase.y[0]) & (degrees < phase.y[1])
        parts.append(dots(phase, s.hz[seen], degrees[seen], css))
    return parts


def _empirical_band(s: Spectrum, gain: Axes, phase: Axes, degrees: FloatArray) -> list[Markup]:
    """95 % whiskers of gain and phase where the coherence is above one half."""
    spread = 1.96 * s.relative_error
    db = 20 * np.log10(np.maximum(np.abs(s.response), 1e-12))
    upper = 20 * np.log10(1.0 + spread)
    lower = 20 * np.log10(np.maximum(1.0 - spread, 1e-2))
    turn = spread * 180 / np.pi
    shown = (s.coherence > 0.5) & (s.hz >= gain.x[0]) & (s.hz <= gain.x[1])
    parts = []
    for k in np.flatnonzero(shown):
        at = np.full(2, s.hz[k])
        for axes, low, high in (
            (gain, db[k] + lower[k], db[k] + upper[k]),
            (phase, degrees[k] - turn[k], degrees[k] + turn[k]),
        ):
            ends = np.clip(np.array([low, high]), *axes.y)
            if ends[0] < ends[1]:
                parts.append(line(axes, at, ends, "whisker thin"))
    return parts


def static_map(
    u: FloatArray,
    y: FloatArray,
    levels: FloatArray,
    curves: Mapping[str, FloatArray],
    words: tuple[str, str, str],
) -> Markup:
    """Training samples (u, y) as dots, each model's steady output over `levels`; words: x, y, label."""
    vertical = span(y, *[c for c in curves.values() if np.isfinite(c).any()])
    spread = 1.5 * (float(np.ptp(y)) or 1.0)
    vertical = (max(vertical[0], float(y.min()) - spread), min(vertical[1], float(y.max()) + spread))
    axes = Axes(span(u, levels), vertical, width=HALF - 60, height=170)
    step = max(1, len(u) // 500)
    parts = [frame(axes, words[1], words[0]), dots(axes, u[::step], y[::step], "dot faint")]
    parts += [line(axes, levels, curve, css) for css, curve in curves.items()]
    return picture(HALF, 234, parts, words[2])


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
