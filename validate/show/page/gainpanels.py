"""What the logged gains mean, on the page: one panel per axis, with its loop in the complex plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from flysid.escaping import one_line
from flysid.loops.judged import Judged
from flysid.loops.nyquist import Curve, curve_of
from flysid.validate.show.page.svg import HALF, Axes, dots, frame, line, picture, segment, text

REAL = (-2.4, 0.9)
IMAGINARY = (-2.1, 0.6)
LABELLED_HZ = (1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 30.0, 50.0)


@dataclass(frozen=True)
class LoopPanel:
    """One axis under one set of gains.

    `lines`: crossover, margins, bandwidth and what is known; or why nothing is known, and what to fly.
    `nyquist`: the picture; empty where the axis was refused.
    """

    title: str
    lines: tuple[str, ...]
    nyquist: Markup


def loop_panels(judged: Sequence[Judged]) -> tuple[LoopPanel, ...]:
    """Every axis in its order."""
    panels = []
    for j in judged:
        head, *lines = (_sentence(words.strip()) for words in j.lines())
        curve = curve_of(j)
        drawn = Markup("") if curve is None else nyquist(curve, f"Nyquist plot of the {j.axis} loop")
        panels.append(LoopPanel(head, tuple(lines), drawn))
    return tuple(panels)


def _sentence(words: str) -> str:
    return one_line(f"{words[:1].upper()}{words[1:]}")


def nyquist(curve: Curve, label: str) -> Markup:
    """The open loop with its 95 % discs, the unit circle, and the circle of Ms = 2 about -1."""
    width = HALF - 60
    height = width * (IMAGINARY[1] - IMAGINARY[0]) / (REAL[1] - REAL[0])
    axes = Axes(REAL, IMAGINARY, width=width, height=height)
    turn = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 181))
    zero = float(axes.py(0.0))
    parts = [
        frame(axes, "imaginary part", "real part"),
        segment(axes.left, zero, axes.right, zero, "axis"),
        _inside(axes, turn, "circle"),
        _inside(axes, turn / 2.0 - 1.0, "other arx"),
        _discs(axes, curve),
        _inside(axes, curve.loop, "ts"),
        *_frequencies(axes, curve),
        text(float(axes.px(-1.0)) + 7, zero - 6, "−1"),
        dots(axes, np.array([-1.0]), np.array([0.0]), "bead"),
    ]
    return picture(HALF, axes.bottom + 42, parts, label)


def _inside(axes: Axes, z: np.ndarray, css: str) -> Markup:
    """A curve in the complex plane, cut at the picture's edges."""
    seen = _seen(axes, z)
    return line(axes, np.where(seen, z.real, np.nan), np.where(seen, z.imag, np.nan), css)


def _seen(axes: Axes, z: np.ndarray) -> np.ndarray:
    across = (z.real >= axes.x[0]) & (z.real <= axes.x[1])
    return np.asarray(across & (z.imag >= axes.y[0]) & (z.imag <= axes.y[1]))


def _discs(axes: Axes, curve: Curve) -> Markup:
    """Discs that lie in the picture, as one area."""
    scale = axes.width / (axes.x[1] - axes.x[0])
    d = ""
    for z, radius in zip(curve.loop, curve.radius, strict=True):
        corners = z + radius * np.array([1.0, -1.0, 1j, -1j])
        if not _seen(axes, corners).all():
            continue
        r = radius * scale
        left = float(axes.px(z.real)) - r
        d += f"M{left:.1f} {float(axes.py(z.imag)):.1f}a{r:.1f} {r:.1f} 0 1 0 {2 * r:.1f} 0"
        d += f"a{r:.1f} {r:.1f} 0 1 0 {-2 * r:.1f} 0Z"
    return Markup('<path d="{}" class="sure ts"/>').format(d)


def _frequencies(axes: Axes, curve: Curve) -> list[Markup]:
    """Dots with their frequency on the curve."""
    parts = []
    for hz in LABELLED_HZ:
        if not curve.f[0] <= hz <= curve.f[-1]:
            continue
        z = np.interp(hz, curve.f, curve.loop.real) + 1j * np.interp(hz, curve.f, curve.loop.imag)
        if _seen(axes, np.array([z]))[0]:
            parts.append(dots(axes, np.array([z.real]), np.array([z.imag]), "dot"))
            parts.append(text(float(axes.px(z.real)) + 6, float(axes.py(z.imag)) + 12, f"{hz:g} Hz"))
    return parts
