"""Several sets of gains beside each other, an axis at a time: what a tuner has flown, in one table.

Flights differ from each other. Figures of two sets are therefore compared by intervals that hold the scatter
between flights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from flysid.loops.contradictions import short_name
from flysid.loops.judged import Judged
from flysid.loops.margins import Figure, Margins
from flysid.showing import counted

HEADINGS = ("AXIS", "GAINS", "FLIGHTS", "CROSSOVER, Hz", "PHASE, deg", "GAIN, dB", "Ms", "BANDWIDTH, Hz")
Best = Literal["phase_deg", "bandwidth_hz"]
Named = Literal["crossover_hz", "phase_deg", "gain_db", "ms", "bandwidth_hz"]


def gain_sets(found: Sequence[Judged]) -> list[tuple[str, ...]]:
    """A row for every set of gains, where an axis flew more than one; nothing otherwise.

    Beside a figure stands half of its 95 % interval between flights.
    """
    axes = [judged.axis for judged in found]
    several = [judged for judged in found if axes.count(judged.axis) > 1 and judged.gains]
    return [HEADINGS, *(_row(judged) for judged in several)] if several else []


def _gains(judged: Judged) -> str:
    """ "P 46, I 45" of "rollPID P 46, I 45", "P 0.15" of "MC_ROLLRATE_P 0.15"."""
    return ", ".join(f"{short_name(name)} {value:g}" for name, value in judged.gains.items())


def _row(judged: Judged) -> tuple[str, ...]:
    head = (judged.axis, _gains(judged), str(len(judged.flights)))
    if judged.margins is None:
        return (*head, "refused, see above", "", "", "", "")
    return (
        *head,
        _cell(judged, "crossover_hz", ".1f"),
        _cell(judged, "phase_deg", ".0f"),
        _cell(judged, "gain_db", ".1f"),
        _cell(judged, "ms", ".2f"),
        _cell(judged, "bandwidth_hz", ".1f"),
    )


def _cell(judged: Judged, name: Named, form: str) -> str:
    """ "15.5 +-1.2"; "15.5 +-?" where the flights cannot tell how far they scatter; "> 7.6", or "?"."""
    own: Figure = getattr(judged.margins, name)
    across: Figure = getattr(judged.across, name, Figure(None))
    if across.value is not None:
        return f"{across.value:{form}} +-{across.high - across.value:{form}}"
    if own.value is not None:
        return f"{own.value:{form}} +-?"
    return f"> {own.low:{form}}" if math.isfinite(own.low) else "?"


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
    """The set with the largest figure; which others its interval between flights does not part from it."""
    stated = [judged for judged, own in known if getattr(own, name).value is not None]
    if len(stated) < 2:
        return f"{words}: not determined"
    best = max(stated, key=lambda judged: getattr(judged.margins, name).value)
    value = getattr(best.margins, name).value
    compared = {judged: getattr(judged.across, name, Figure(None)) for judged in stated}
    top = compared.pop(best)
    if top.value is None:
        return (
            f"{words} at {_gains(best)}: {value:{form}}{unit}, but flights scatter too much to compare sets"
        )
    near = sum(1 for other in compared.values() if other.value is None or other.high >= top.low)
    rest = f", no clear difference to {near} of {counted(len(compared), 'other')}" if near else ", clearly"
    return f"{words} at {_gains(best)}: {top.said(form, unit)}{rest}"
