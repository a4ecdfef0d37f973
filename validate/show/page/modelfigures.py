"""Pictures in which every model of the run has its place: those of the headline are shown, the page's buttons
show the others.

Limits of axes belong to the models of the headline and to the measurement; a model that leaves them is cut.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from markupsafe import Markup

from flysid.dataset import FloatArray
from flysid.model.polynomials import ComplexArray
from flysid.validate.diagnose.residuals import Correlation
from flysid.validate.show.page.overlay import Role
from flysid.validate.show.page.svg import HALF, Axes, box, dots, frame, line, owned, picture, segment, span

Lines = Mapping[Role, FloatArray]


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
