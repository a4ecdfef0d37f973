"""Low-pass filters and notches of a controller: their responses, and their sections in a firmware.

A low-pass of several equal stages (PT2, PT3) is that many of first order, each with a higher cut-off, so that
the whole is at -3 dB where it says.

Source: Betaflight's filter.c; the sections are those of `flysid.spectra.stages`.
"""

from __future__ import annotations

import numpy as np

from flysid.dataset import FloatArray
from flysid.spectra.stages import ComplexArray as ComplexArray
from flysid.spectra.stages import Kind, Stage, response_of

Filters = tuple[tuple[int, float], ...]
"""Orders (1, or 2 for a Butterworth biquad) and cut-offs (Hz), one behind the other."""
Notches = tuple[tuple[float, float, float], ...]
"""Centres (Hz), qualities, and the gain at the centre, one behind the other."""
STAGES = {"pt1": 1, "pt2": 2, "pt3": 3}
KINDS = {1: Kind.PT1, 2: Kind.BIQUAD}
"""Order of a low-pass -> its law."""


def filters_of(kind: str, hz: float) -> Filters:
    """A low-pass by its firmware's name: pt1, pt2, pt3 or biquad; none for a cut-off of 0.

    >>> filters_of("biquad", 90.0), filters_of("pt1", 0.0)
    (((2, 90.0),), ())
    >>> [round(hz, 1) for _, hz in filters_of("pt2", 100.0)]
    [155.4, 155.4]
    """
    if hz <= 0.0:
        return ()
    if kind == "biquad":
        return ((2, hz),)
    stages = STAGES[kind]
    return ((1, hz / np.sqrt(2.0 ** (1.0 / stages) - 1.0) if stages > 1 else hz),) * stages


def sections(filters: Filters, notch: tuple[float, float], step_s: float) -> FloatArray:
    """(S, 5) b0, b1, b2, a1, a2 of a notch (centre and lower cut-off, Hz) and low-passes behind it."""
    centre, cut = notch
    stages = [Stage(Kind.NOTCH, centre, centre * cut / (centre**2 - cut**2))] if centre > cut > 0.0 else []
    stages += [Stage(KINDS[order], hz) for order, hz in filters]
    return np.array([row for stage in stages for row in np.vstack(stage.sections(1.0 / step_s))]).reshape(
        -1, 5
    )


def response(filters: Filters, f: FloatArray, notch: tuple[float, float] = (0.0, 0.0)) -> ComplexArray:
    """(F,) of low-passes one behind the other and a notch, at frequencies far below their sample rate.

    A cut-off of 0 is no filter.
    """
    through: ComplexArray = np.ones(len(f), dtype=np.complex128)
    for order, cut in filters:
        if cut > 0.0:
            x = 1j * f / cut
            through = through / (1.0 + x if order == 1 else 1.0 + np.sqrt(2.0) * x + x * x)
    centre, cut = notch
    if centre > cut > 0.0:
        far = f / centre
        through = through * (1.0 - far * far) / (1.0 + 1j * far * (centre / cut - cut / centre) - far * far)
    return np.asarray(through)


def sampled_response(filters: Filters, f: FloatArray, step_s: float) -> ComplexArray:
    """(F,) of low-passes one behind the other as a loop of this step computes them.

    A low-pass of first order goes w / (1 + w) of the way in a step, w = 2 pi Hz times the step. Where a step
    is not short beside the filter, its cut-off is lower than the stated one, and its phase lags less.
    """
    rows = sections(tuple((order, hz) for order, hz in filters if hz > 0.0), (0.0, 0.0), step_s)
    return response_of([row[None] for row in rows], f, 1.0 / step_s)


def notched(notches: Notches, f: FloatArray) -> ComplexArray:
    """(F,) of notches that leave a share of their centre.

    >>> np.abs(notched(((50.0, 2.0, 0.1),), np.array([50.0]))).round(3).tolist()
    [0.1]
    """
    through: ComplexArray = np.ones(len(f), dtype=np.complex128)
    for centre, quality, left in notches:
        x = 1j * f / centre
        through = through * (1.0 + left * x / quality + x * x) / (1.0 + x / quality + x * x)
    return np.asarray(through)
