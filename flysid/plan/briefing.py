"""What to do with a plan, in words, and the recipe that identifies from its log."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.escaping import toml_document
from flysid.flight import split_address
from flysid.plan.flightplan import CommandedAxis, FlightPlan

TABLE = "table"
"""The one stream of a table in text."""
REACH = (2.5, 97.5)
"""Percentiles between which an axis counts as flown: a single knock is no amplitude to plan with."""


def axes_of_last_flight(data: Dataset) -> tuple[CommandedAxis, ...]:
    """The inputs, each as far to either side as the last flight went.

    Raises UsageError: an input did not move in the last flight.
    """
    last = data.flights[-1]
    u = np.concatenate([s.u for s in data.segments if s.flight == last])
    low, high = np.percentile(u, REACH, axis=0)
    still = [s.name for s, width in zip(data.inputs, high - low, strict=True) if width <= 0.0]
    if still:
        raise UsageError(
            f"{', '.join(still)} did not move in flight {last}: no amplitude to go by",
            hint=f"give one: --axis {still[0]}=PEAK",
        )
    return tuple(
        CommandedAxis(signal.name, float(width) / 2.0, signal.unit)
        for signal, width in zip(data.inputs, high - low, strict=True)
    )


def recipe_for(plan: FlightPlan, outputs: Sequence[str]) -> str:
    """A recipe for the log of the plan: every output driven by all axes.

    `outputs`: columns of the log, as FIELD of a table or STREAM.FIELD of a log.
    Raises UsageError: an output that is an axis.
    """
    names = {word: re.sub(r"\W+", "_", word).strip("_") for word in (*(a.name for a in plan.axes), *outputs)}
    if len(set(names.values())) < len(plan.axes) + len(outputs):
        raise UsageError("an output is named twice, or is an axis", hint="--to names what answers the axes")
    units = {a.name: a.unit for a in plan.axes}
    signals = {
        name: {
            "unit": units.get(word, ""),
            "hold": "zero" if word in units else "linear",
            "sources": [_source(word)],
        }
        for word, name in names.items()
    }
    driving = [names[a.name] for a in plan.axes]
    channels = {names[o]: {"inputs": driving, "outputs": [names[o]]} for o in outputs}
    title = f"a planned flight: {', '.join(map(str, plan.axes))}"
    return toml_document({"name": "plan", "description": title, "signals": signals, "channels": channels})


def _source(word: str) -> dict[str, str]:
    stream, field = split_address(word)
    return {"stream": stream or TABLE, "field": field}


def briefing(plan: FlightPlan) -> list[str]:
    """What is flown and what to mind, one sentence a line."""
    low, high = plan.band_hz
    axes = ", ".join(map(str, plan.axes))
    lines = [f"{plan.kind}, {plan.seconds:.4g} s, {low:.3g} to {high:.3g} Hz: {axes}."]
    if plan.kind == "multisine":
        worst = max(plan.peak_factors)
        counts = ", ".join(str(len(own)) for own in plan.lines)
        apart = (
            f"All axes at once, {counts} frequencies, none shared; correlation of axes {plan.correlation:.1g}"
            if len(plan.axes) > 1
            else f"{counts} frequencies"
        )
        lines.append(f"{apart}, relative peak factor {worst:.3g} at most.")
        lines.append("Fly it whole: a period cut short shares its frequencies between axes. Twice is better.")
    else:
        lines.append(f"One axis after the other, {plan.seconds / len(plan.axes):.4g} s each.")
    if plan.kind == "doublets":
        lines.append("Doublets excite only the middle of the band; a multisine or chirp excites all of it.")
    return lines + _minding(plan)


def _minding(plan: FlightPlan) -> list[str]:
    together = " together" if plan.kind == "multisine" and len(plan.axes) > 1 else ""
    return [
        "Beforehand: fly it in a simulator; then in calm air, high, with room on every side and a geofence.",
        f"Begin with a third of these amplitudes. The peaks add to what you steer{together}: leave the "
        "motors and surfaces half of their range.",
        "Trim first, take your hands off the axes under test, and be ready to take over: stop at once where "
        "the vehicle swings wider than the plan, drifts off, or motors saturate.",
        "Log what is commanded and what answers at ten times the highest frequency "
        f"({10 * plan.band_hz[1]:.3g} Hz), and fly the same once more to be held out.",
    ]
