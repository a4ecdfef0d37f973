"""What went wrong by the log's own words, and where roll or pitch left its setpoint for good.

Where a log states the attitude and the setpoint, ArduPilot's criterion of a crash is looked for: more than
30 degrees apart for 2 s while flying (ArduCopter/crash_check.cpp).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from flysid.errors import RecipeError
from flysid.ingest.align import resample
from flysid.ingest.align.conditions import condition_spans
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.align.resample import FOREVER, Span
from flysid.ingest.align.signals import Log, Samples, load_signal
from flysid.ingest.lake.failures import Mishap, stated_failures

APART_DEG = 30.0
ATTITUDES = ("ardupilot-attitude", "px4-attitude")


def failures(log: Log) -> list[Mishap]:
    """All that went wrong, in order of boot and time: a breached fence, too, which spoils nothing."""
    return sorted([*stated_failures(log), *_attitude_lost(log)], key=lambda m: (m.boot, m.span))


def _attitude_lost(log: Log, *, apart_s: float = 2.0) -> Iterator[Mishap]:
    """From where roll or pitch stays far from its setpoint, to the boot's end."""
    for name in ATTITUDES:
        recipe = load_recipe(name)
        flying = condition_spans(recipe.conditions, log).spans
        for channel in recipe.channels.values():
            pair = channel.inputs[0], channel.outputs[0]
            try:
                asked, come = (load_signal(s, recipe.signals[s], log).boots for s in pair)
            except RecipeError:
                continue  # this log does not state it
            for boot in sorted(asked.keys() & come.keys()):
                runs = _far_apart(asked[boot], come[boot])
                start = next((a for a, b in resample.intersect(runs, flying.get(boot, [(0, FOREVER)]))
                              if b - a >= apart_s * 1e9), None)  # fmt: skip
                if start is not None:
                    words = f"{pair[1]} more than {APART_DEG:.0f} deg from its setpoint for {apart_s:g} s"
                    yield Mishap(boot, (start, FOREVER), words, ends=True)


def _far_apart(asked: Samples, come: Samples) -> list[Span]:
    wanted = resample.tidy(asked.t_ns, asked.x)
    series = resample.tidy(come.t_ns, come.x)
    if not (len(wanted.t_ns) and len(series.t_ns)):
        return []
    inside = (series.t_ns >= wanted.t_ns[0]) & (series.t_ns <= wanted.t_ns[-1])
    t_ns = series.t_ns[inside]
    error = series.x[inside] - resample.hold(wanted, t_ns)
    return _runs(t_ns, np.abs((error + 180.0) % 360.0 - 180.0) > APART_DEG)


def _runs(t_ns: Any, holds: Any) -> list[Span]:
    """Spans of consecutive samples for which something holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(np.int8), [0]])))
    return [(int(t_ns[a]), int(t_ns[b - 1]) + 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
