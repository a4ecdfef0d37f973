"""Commands that a log holds only where they change: each value counts until the next, however late it comes.

Taken for samples of an even rate, such a command would set the grid's rate by its own, and every long pause
in it would end a segment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from flysid.ingest.align.recipe import Recipe, SignalSpec
from flysid.ingest.align.resample import RecordedSignal, tidy
from flysid.ingest.align.signals import Log, find_source, load_signal

NEAR = 0.25
"""How far from the median, in medians, distances of samples of an even rate lie."""
EVEN = 0.5
"""Share of the distances that lie near the median where samples are of an even rate; others may be lost."""
BURST = 0.1
"""In medians: closer together than this, samples come in bursts, as over a radio."""
BURSTS = 1.0 / 3.0
"""Share of the distances that are short where samples come in bursts."""
FEWEST = 9
"""Samples from which on their times say something."""


def held_specs(recipe: Recipe, channel: str, logs: Sequence[Log]) -> Mapping[str, SignalSpec]:
    """The signals of a channel; commands that every log has on change get an endless longest gap, if none."""
    specs = {name: recipe.signals[name] for name in recipe.signals_of(channel)}
    return {
        name: replace(spec, max_gap_s=float("inf")) if _is_event(name, spec, logs) else spec
        for name, spec in specs.items()
    }


def _is_event(name: str, spec: SignalSpec, logs: Sequence[Log]) -> bool:
    if spec.hold != "zero" or spec.max_gap_s is not None:
        return False
    known = [log for log in logs if find_source(spec.sources, log) is not None]
    boots = [boot for log in known for boot in load_signal(name, spec, log).boots.values()]
    return bool(boots) and all(is_logged_on_change(tidy(boot.t_ns, boot.x)) for boot in boots)


def is_logged_on_change(series: RecordedSignal, *, alike: float = 0.05) -> bool:
    """Whether samples come at uneven times, each unlike the last.

    `alike`: share of samples that may be like the last; rounding makes a few so.
    """
    if len(series.x) < FEWEST:
        return False
    steps = np.diff(series.t_ns).astype(np.float64)
    middle = float(np.median(steps))
    near = np.mean(np.abs(steps - middle) < NEAR * middle)
    bursts = np.mean(steps < BURST * middle)
    same = np.mean(np.diff(series.x) == 0.0)
    return bool(near < EVEN and bursts < BURSTS and same <= alike)
