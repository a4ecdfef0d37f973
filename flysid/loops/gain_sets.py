"""Several sets of gains beside each other, an axis at a time: what a tuner has flown, in one table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from flysid.loops.judged import Judged
from flysid.loops.margins import Figure, Margins
from flysid.showing import counted

HEADINGS = ("AXIS", "GAINS", "FLIGHTS", "CROSSOVER, Hz", "PHASE, deg", "GAIN, dB", "Ms", "BANDWIDTH, Hz")
Best = Literal["phase_deg", "bandwidth_hz"]


def gain_sets(found: Sequence[Judged]) -> list[tuple[str, ...]]:
    """A row for every set of gains, where an axis flew more than one; nothing otherwise."""
    axes = [judged.axis for judged in found]
    several = [judged for judged in found if axes.count(judged.axis) > 1 and judged.gains]
    return [HEADINGS, *(_row(judged) for judged in several)] if several else []


def _gains(judged: Judged) -> str:
    """ "P 46, I 45" of "rollPID P 46, I 45", "P 0.15" of "MC_ROLLRATE_P 0.15"."""
    return ", ".join(f"{name.split()[-1].split('_')[-1]} {value:g}" for name, value in judged.gains.items())


def _row(judged: Judged) -> tuple[str, ...]:
    head = (judged.axis, _gains(judged), str(len(judged.flights)))
    m = judged.margins
    if m is None:
        return (*head, "refused, see above", "", "", "", "")
    return (
        *head,
        _cell(m.crossover_hz, ".1f"),
        _cell(m.phase_deg, ".0f"),
        _cell(m.gain_db, ".1f"),
        _cell(m.ms, ".2f"),
        _cell(m.bandwidth_hz, ".1f"),
    )


def _cell(figure: Figure, form: str) -> str:
    if figure.value is not None:
        return f"{figure.value:{form}}"
    return f"> {figure.low:{form}}" if math.isfinite(figure.low) else "?"


def differences(found: Sequence[Judged]) -> list[str]:
    """What sets an axis' gains apart: the largest phase margin and the widest bandwidth, if surely so."""
    lines = []
    for axis in dict.fromkeys(judged.axis for judged in found):
        known = [(j, j.margins) for j in found if j.axis == axis and j.margins is not None]
        if len(known) > 1:
            margin = _best(known, "phase_deg", "largest phase margin", ".0f", " deg")
            bandwidth = _best(known, "bandwidth_hz", "widest bandwidth", ".1f", " Hz")
            lines.append(f"{axis}: {margin}; {bandwidth}")
    return lines


def _best(known: Sequence[tuple[Judged, Margins]], name: Best, words: str, form: str, unit: str) -> str:
    """The set with the largest figure; which others its interval does not part from it."""
    figures = [(judged, getattr(m, name)) for judged, m in known if getattr(m, name).value is not None]
    if len(figures) < 2:
        return f"{words}: not determined"
    best, top = max(figures, key=lambda pair: pair[1].value)
    near = sum(1 for judged, figure in figures if judged is not best and figure.high >= top.low)
    rest = f", no clear difference to {near} of {counted(len(figures) - 1, 'other')}" if near else ", clearly"
    return f"{words} at {_gains(best)}: {top.said(form, unit)}{rest}"
