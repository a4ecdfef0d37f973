"""A second of a held-out flight: active rules, their conclusions, and what a page needs to fly the models.

A page that moves the input computes the free run itself. For that it gets the numbers of a model's recursion
(`Recursion`) and the rows that a run stands on; the page's arithmetic is the compiled kernel's.
"""

from __future__ import annotations

from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment
from flysid.errors import UsageError
from flysid.extras import Extra, Missing, extra
from flysid.facts.clock import log_clock
from flysid.manifest import FLIGHTS, read_manifest
from flysid.model.base import Fitted
from flysid.model.capabilities import DeviationEquation, HasExplanation, HasRuleOutputs, HasRuleRecursion
from flysid.model.start import as_modelled, drifting_of, run_from_window, start_window
from flysid.model.structures import leaders
from flysid.studio.flights import RUN, SIGNAL
from flysid.studio.folders import NotThere, Workspace, is_name, short_id
from flysid.studio.forms import Explained
from flysid.validate.compare.trials import MIN_SCORED, free_run, start_of
from flysid.validate.runs.run import RECIPE_FILE, RUN_FILE, HeldOut, held_out, open_run

KEPT = 4  # runs whose held-out data stay in memory
MOST_ROWS = 20_000  # of a segment in one answer


def explain(workspace: Workspace, run_id: str, asked: Explained) -> dict[str, Any]:
    """Signals, free runs, rules and recursions of one held-out segment.

    Raises NotThere: no such run, channel or segment. Raises UsageError, DataError: the data is gone or has
    changed.
    """
    folder = workspace.run(run_id)
    missing = Missing()
    with missing.gathering():
        channels = _held(folder, (folder / RUN_FILE).stat().st_mtime_ns)
    if asked.ch not in channels:
        raise NotThere(f"no channel {asked.ch!r} in the run", path=folder)
    found = channels[asked.ch]
    if not 0 <= asked.segment < len(found.test.segments):
        raise NotThere(f"{len(found.test.segments)} segments are held out, counted from 0")
    segment = found.test.segments[asked.segment]
    if len(segment) > MOST_ROWS:
        segment = Segment(segment.u[:MOST_ROWS], segment.y[:MOST_ROWS], segment.t0_ns, segment.flight)
    labels = _shown(found)
    first = start_window(
        start_of({name: found.models[name] for name in labels}), len(segment), found.test.dt_s
    )
    if asked.row is not None:
        return _in_words(found, segment, asked.row)
    with missing.gathering():
        flown = {name: _model(found.models[name], segment, first) for name in labels}
    return {
        "flight": segment.flight,
        "seen": seen_at(workspace, folder, found.test, segment),
        "segments": [[s.flight, len(s) * found.test.dt_s] for s in found.test.segments],
        "dt_s": found.test.dt_s,
        "first": first,
        "inputs": [[s.name, s.unit] for s in found.test.inputs],
        "outputs": [[s.name, s.unit] for s in found.test.outputs],
        "u": segment.u.tolist(),
        "y": segment.y.tolist(),
        "models": flown,
        **missing.to_dict(),
    }


def worst_seconds(workspace: Workspace, run_id: str) -> dict[str, Any]:
    """By channel: the held-out second in which the model that the verdict is about errs most.

    Raises NotThere: no such run. Raises UsageError, DataError: the data is gone or has changed.
    """
    folder = workspace.run(run_id)
    channels = _held(folder, (folder / RUN_FILE).stat().st_mtime_ns)
    worst = {
        name: extra(Extra.WORST, partial(_worst, workspace, folder, found), None, name)
        for name, found in channels.items()
    }
    return {name: second for name, second in worst.items() if second is not None}


def _worst(workspace: Workspace, folder: Path, found: HeldOut) -> dict[str, Any]:
    label = _shown(found)[-1]
    model, dt_s = found.models[label], found.test.dt_s
    width = max(1, round(1.0 / dt_s))
    scale = np.maximum(np.std(np.concatenate([s.y for s in found.test.segments]), axis=0), 1e-12)
    best = (-1.0, 0, 0)
    for number, segment in enumerate(found.test.segments):
        first = start_window(start_of({label: model}), len(segment), dt_s)
        if len(segment) < first + MIN_SCORED:
            continue
        errors = np.mean(((free_run(model, segment, first) - segment.y[first:]) / scale) ** 2, axis=1)
        sums = np.convolve(errors, np.ones(min(width, len(errors))), "valid")
        row = int(np.argmax(sums))
        best = max(best, (float(sums[row]), number, first + row + min(width, len(errors)) // 2))
    _, number, row = best
    segment = found.test.segments[number]
    seen = seen_at(workspace, folder, found.test, segment)
    return {"model": label, "segment": number, "row": row, "second_s": row * dt_s, "seen": seen}


def seen_at(workspace: Workspace, run: Path, data: Dataset, segment: Segment) -> dict[str, Any] | None:
    """The flight of a segment, the second at which it begins there, and the signals; None if not here."""
    flight, _, boot = segment.flight.partition("#")
    place = workspace.data / FLIGHTS / flight
    if not is_name(flight) or not place.is_dir():
        return None
    offsets = log_clock(read_manifest(place).clocks).offsets_s
    start_s = segment.t0_ns * 1e-9 + offsets.get(int(boot) if boot else min(offsets, default=0), 0.0)
    has_recipe = (run / RECIPE_FILE).is_file()
    recipe = f"{SIGNAL}{RUN}{short_id(run)}"
    signals = [f"{recipe}:{s.name}" for s in (*data.inputs, *data.outputs)] if has_recipe else []
    return {"flight": flight, "begin_s": start_s, "signals": signals}


@lru_cache(KEPT)
def _held(folder: Path, _stamp: int) -> dict[str, HeldOut]:
    return {item.channel.name: item for item in held_out(open_run(folder))}


def _shown(found: HeldOut) -> list[str]:
    """The linear baseline and the model with rules that the verdict is about."""
    rules = next((label for label in leaders() if label in found.models), None)
    return list(dict.fromkeys([found.channel.baseline, *([rules] if rules else [])]))


def _model(model: Fitted, segment: Segment, first: int) -> dict[str, Any]:
    run = free_run(model, segment, first)
    described: dict[str, Any] = {
        "structure": model.structure,
        "yh": run.tolist(),
        "recursion": extra(Extra.RECURSION, partial(recursion, model, segment, first), None),
    }
    if isinstance(model, HasRuleOutputs):
        described |= extra(Extra.VOICES, partial(_voices, model, segment, first), {})
    return described


def _voices(model: Any, segment: Segment, first: int) -> dict[str, Any]:
    """The rules, how loudly they speak and what they conclude, from row `first` on."""
    y = as_modelled(model, segment).y
    said = model.rule_outputs(segment.u, y)[first:]
    return {
        "rules": [rule.label for rule in model.rules()],
        "firing": model.firing(segment.u, y)[first:].tolist(),
        "said": np.where(np.isfinite(said), said, 0.0).tolist(),
    }


def _in_words(found: HeldOut, segment: Segment, row: int) -> dict[str, Any]:
    """What every model with rules concluded at one row, and on what ground."""
    if not 0 <= row < len(segment):
        raise UsageError(f"row {row} of {len(segment)}")
    words = {}
    missing = Missing()
    shown = ((label, found.models[label]) for label in _shown(found))
    ruled = {label: model for label, model in shown if isinstance(model, HasExplanation)}
    with missing.gathering():
        for label, model in ruled.items():
            words[label] = extra(Extra.EXPLAINED, partial(_explained, model, segment, row), "", label)
    return {"words": words, **missing.to_dict()}


def _explained(model: Any, segment: Segment, row: int) -> str:
    y = as_modelled(model, segment).y
    return str(model.explain(segment.u, y, max(row, model.n_init)))


def recursion(model: Fitted, segment: Segment, first: int) -> dict[str, Any] | None:
    """The numbers that carry a free run on from row `first`; None for structures that no page computes.

    Of a linear difference equation: `a`, `b`, `c` about `u_origin`, `y_origin`, clamped to `limits` at the
    end. Of rules: the compiled kernel's lags and parameters (`flysid.model.rules.kernel`), `shift` and
    `scale` of W's columns. `before` holds the rows ahead of `first`: outputs, or W's simulated columns. None,
    too, where the segment is so short that these rows are the estimated start itself, and where the segment
    has a constant of its own beside the model.
    """
    if first < 2 * model.n_init or drifting_of([model]) is not None:
        return None
    if isinstance(model, DeviationEquation):
        equation = model.system
        run = run_from_window(model, segment, first)
        kept = {name: getattr(equation, name).tolist() for name in ("a", "b", "c")}
        about = {"u_origin": model.u_origin.tolist(), "y_origin": model.y_origin.tolist()}
        return {
            "kind": "linear",
            **kept,
            **about,
            "limits": model.output_limits.tolist(),
            "before": run[:first].tolist(),
        }
    if isinstance(model, HasRuleRecursion):
        W = model.layout.stack(segment.u, run_from_window(model, segment, first))
        if model.layout.hidden:
            W = model.run(segment.u, segment.y[:first])
        return _rules(model.layout, model.free, W[:first])
    return None


def _rules(layout: Any, parameters: Any, before: FloatArray) -> dict[str, Any]:
    return {
        "kind": "rules",
        "lags": {name: values.tolist() for name, values in layout.lags._asdict().items()},
        **{name: values.tolist() for name, values in parameters._asdict().items()},
        "shift": layout.shift.tolist(),
        "scale": layout.scale.tolist(),
        "before": before.tolist(),
    }
