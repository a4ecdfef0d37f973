"""Two runs against each other on data that neither has trained on.

The data are the held-out part of run B without the flights that run A has trained on. Run A's training data
are made again to know which flights those are, and to find copies of them under other names. Where that
cannot be done, nothing is compared: a verdict on training data is worth nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from flysid.catalogue import FlightFacts
from flysid.dataset import Dataset
from flysid.errors import DataError, FlysidError, UsageError
from flysid.extras import Extra, Missing, extra
from flysid.ingest.align.doubts import Doubt, vehicles_of
from flysid.ingest.lake.chosen_flights import Selection, require_one_vehicle
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.lake import open as open_lake
from flysid.model.base import Fitted
from flysid.model.structures import kind_of, leaders
from flysid.progress import tell
from flysid.split import Piece, Split, refuse_copies
from flysid.validate.compare.comparison import Comparison
from flysid.validate.compare.models import across_channels, compare_models, headline, sides_of
from flysid.validate.diagnose.context import ReportContext
from flysid.validate.runs.expected import expected_document
from flysid.validate.runs.fitone import nothing_done
from flysid.validate.runs.judge import Judgement
from flysid.validate.runs.judgedparts import chosen_lake, restrict
from flysid.validate.runs.provenance import fit_command, split_words
from flysid.validate.runs.run import HeldOut, Run, held_out, models_of


@dataclass(frozen=True)
class RunSource:
    """A run, and where its ingested folder is now (None: where it was at the fit)."""

    run: Run
    data: Path | None = None


def judge_runs(
    a: RunSource, b: RunSource, *, label: str | None = None, only: Selection | None = None
) -> Judgement:
    """Compare every channel that two runs share.

    `label`: the model the headline speaks of, in both runs; the fuzzy one where both have it, else run B's
        baseline.
    `only`: compare on these of run B's held-out flights and stretches alone; flights of several vehicles are
        put together only where it says `pool`.
    Raises DataError: no channel can be compared, or it cannot be ruled out that A was trained on B's held-out
    part. Raises StoreError, UsageError: a run or a data folder cannot be read.
    """
    tell("aligning the data of both runs", share=0.0)
    chosen = None if only is None else chosen_lake(b.run, b.data, only)  # from the catalogue: before tables
    missing = Missing(*a.run.missing, *b.run.missing)
    with missing.gathering():
        ours = {h.channel.name: h for h in held_out(b.run, b.data)}
        theirs = {h.channel.name: h for h in _training_of(a)}
    shared = [name for name in ours if name in theirs]
    if not shared:
        raise DataError(f"the runs share no channel: {_names(theirs)} and {_names(ours)}")
    if only is None or not only.pool:
        _refuse_several_vehicles(b, chosen, ours)
    found: dict[str, Comparison] = {}
    failed: dict[str, DataError] = {}
    for i, name in enumerate(shared):
        tell("comparing", channel=name, share=(i + 1) / (len(shared) + 1))
        try:
            judged = ours[name] if chosen is None else restrict(ours[name], chosen)
            found[name] = _compare(theirs[name], judged, label)
        except DataError as error:
            failed[name] = error
    if not found:
        raise nothing_done("", "compared", {name: str(error) for name, error in failed.items()})
    corrected = across_channels(found)
    context = _context(a.run, b.run, corrected, {n: (theirs[n], ours[n]) for n in found})
    seconds = {n: _seconds("a", theirs[n]) | _seconds("b", ours[n]) for n in found}
    skipped = {name: "fitted by run B only" for name in ours if name not in theirs}
    skipped |= {name: "fitted by run A only" for name in theirs if name not in ours}
    skipped |= {name: error.advice for name, error in failed.items()}
    judged_on = [comparison.test for comparison in found.values()]
    doubts = {n: doubt for n, c in found.items() if (doubt := _of_other_vehicles(theirs[n].train, c.test))}
    with missing.gathering():
        flights = extra(Extra.FLIGHTS, partial(_facts_of, b, chosen, judged_on), ())
    context = replace(
        context, fit_seconds=seconds, skipped=skipped, flights=flights, doubts=doubts, missing=missing
    )
    return Judgement(b.run, corrected, skipped, context, tuple(failed))


def _of_other_vehicles(train: Dataset, test: Dataset) -> tuple[Doubt, ...]:
    """Run A's training data and the flights compared on are known to be of vehicles that are not the same."""
    a, b = vehicles_of(train), vehicles_of(test)
    if not (a and b) or set(a) & set(b):
        return ()
    own, other = ", ".join(a), ", ".join(b)
    text = f"run A was fitted to {own}, these flights are of {other}: the change is also that of the vehicles"
    return (Doubt("pooled", text, "compare runs of one vehicle"),)


def _refuse_several_vehicles(b: RunSource, chosen: Lake | None, ours: Mapping[str, HeldOut]) -> None:
    """Raise UsageError where held-out flights are of several vehicles: no verdict is of all of them."""
    if b.run.recipe:
        lake = chosen or open_lake(b.data or b.run.data)
        held = _facts_of(b, lake, [part.test for part in ours.values()])
        require_one_vehicle(lake.only([facts.id for facts in held]))


def _facts_of(b: RunSource, chosen: Lake | None, parts: Sequence[Dataset]) -> tuple[FlightFacts, ...]:
    """What the catalogue knows of the flights of these parts; a dataset file has none."""
    if not b.run.recipe:
        return ()
    lake = chosen or open_lake(b.data or b.run.data)
    held = {flight.partition("#")[0] for part in parts for flight in part.flights}
    return tuple(facts for facts in lake.facts if facts.id in held)


def expected_of_runs(a: Run, b: Run, label: str | None = None) -> dict[str, Any]:
    """The fields that the document of `judge_runs` will have, with values of their types."""
    ours = {c.name: c for c in b.channels}
    theirs = {c.name: c for c in a.channels}
    channels = {}
    for name in (name for name in ours if name in theirs):
        baselines = theirs[name].baseline, ours[name].baseline
        models, heads = _both(models_of(a, theirs[name]), models_of(b, ours[name]), baselines, label)
        channels[name] = models, sides_of(models, *heads)
    return expected_document(channels, {})


def unseen(a: HeldOut, b: HeldOut) -> Dataset:
    """The held-out part of `b` without what `a` was trained on.

    Raises DataError: nothing is left, the signals differ, or a flight repeats a training flight of `a`.
    """
    _check_alike(a.train, b.test)
    if _same_split(a, b):
        return b.test
    known = set(a.seen)
    left = b.test.with_segments([s for s in b.test.segments if s.flight not in known])
    if not left.segments:
        raise DataError(
            "run A was trained on every held-out flight of run B",
            hint="compare on flights that neither run has seen: fit B with more flights, split by flight",
        )
    n = len(a.train.segments)
    both = left.with_segments([*a.train.segments, *left.segments])
    pieces = [Piece(i, 0, len(s)) for i, s in enumerate(both.segments)]
    refuse_copies(both, pieces[:n], pieces[n:])
    return left


def _training_of(a: RunSource) -> list[HeldOut]:
    try:
        return held_out(a.run, a.data)
    except FlysidError as error:
        raise DataError(
            f"it cannot be ruled out that run A was trained on these flights: {error.message}",
            path=a.run.folder,
            hint="give the folder that run A was fitted on with --data-a"
            if isinstance(error, UsageError)
            else error.hint or "fit run A again",
        ) from error


def _same_split(a: HeldOut, b: HeldOut) -> bool:
    """The same data held out alike: then A's training part ends where B's does, blocks of one flight too."""
    one = Split.from_dict(a.channel.split)
    other = Split.from_dict(b.channel.split)
    return (one.data_sha256, one.train, one.test) == (other.data_sha256, other.train, other.test)


def _check_alike(a: Dataset, b: Dataset) -> None:
    for side in ("inputs", "outputs"):
        one, other = ([f"{s.name} [{s.unit}]" for s in getattr(x, side)] for x in (a, b))
        if one != other:
            raise DataError(f"the runs have different {side}: {', '.join(one)} and {', '.join(other)}")
    if abs(a.dt_s - b.dt_s) > 1e-6 * b.dt_s:
        raise DataError(
            f"the runs have different sample times: {a.dt_s:g} s and {b.dt_s:g} s",
            hint="fit both with the same rate_hz in the recipe",
        )


def _compare(a: HeldOut, b: HeldOut, label: str | None) -> Comparison:
    test = unseen(a, b)
    models, (base, contender) = _both(a.models, b.models, (a.channel.baseline, b.channel.baseline), label)
    return compare_models(models, test, baseline=base, contender=contender, seen={*a.seen, *b.seen})


def _both(
    a: Mapping[str, Fitted], b: Mapping[str, Fitted], baselines: tuple[str, str], label: str | None
) -> tuple[dict[str, Fitted], tuple[str, str]]:
    """The models of both runs under the names they are compared by, and the two of the headline.

    `baselines`: the runs'.
    """
    head_a, head_b = _heads(a, b, baselines, label)
    models = {f"a:{name}": m for name, m in a.items() if not _is_reference(m)}
    models |= {f"b:{name}": m for name, m in b.items() if not _is_reference(m)}
    return models | {name: m for name, m in b.items() if _is_reference(m)}, (f"a:{head_a}", f"b:{head_b}")


def _heads(
    a: Mapping[str, Fitted], b: Mapping[str, Fitted], baselines: tuple[str, str], label: str | None
) -> tuple[str, str]:
    """What the headline compares: like with like, or rules of one run with what the other is about."""
    own = headline(a, baselines[0]), headline(b, baselines[1])
    if label is None and own[0] != own[1] and not {*own}.isdisjoint(leaders()):
        return own
    shared = [name for name, m in b.items() if name in a and not _is_reference(m)]
    if label is not None and label not in shared:
        raise UsageError(f"only one of the runs has a model {label!r}", hint=f"one of {', '.join(shared)}")
    if not shared:
        raise DataError(f"the runs share no model: {_names(a)} and {_names(b)}")
    wanted = label or headline(shared, baselines[1])
    return (wanted, wanted) if wanted in shared else (shared[0], shared[0])


def _is_reference(model: Fitted) -> bool:
    return kind_of(model.structure) == "reference"


def _context(
    a: Run, b: Run, comparisons: Mapping[str, Comparison], sides: Mapping[str, tuple[HeldOut, HeldOut]]
) -> ReportContext:
    labels = {str(head).partition(":")[2] for c in comparisons.values() for head in (c.baseline, c.contender)}
    model = f" --model {labels.pop()}" if len(labels) == 1 else ""
    return ReportContext(
        comparisons=comparisons,
        train={name: ours.train for name, (_, ours) in sides.items()},
        command=f"{fit_command(a)} -o RUN_A && {fit_command(b)} -o RUN_B && "
        f"flysid compare RUN_A RUN_B{model}",
        provenance=_provenance(a, b, comparisons, sides),
        remark="two runs, on flights held out by run B that run A has not trained on",
    )


def _provenance(
    a: Run, b: Run, comparisons: Mapping[str, Comparison], sides: Mapping[str, tuple[HeldOut, HeldOut]]
) -> dict[str, str]:
    """Where both runs are from; what they share stands once."""
    found = {"run A": str(a.folder), "run B": str(b.folder)}
    found |= _both_say("recipe", a.recipe, b.recipe)
    for name, (theirs, ours) in sides.items():
        c = comparisons[name]
        one = theirs.channel.split
        other = ours.channel.split
        found |= _both_say(f"{name}: split", split_words(one), split_words(other))
        found |= _both_say(f"{name}: data sha256", str(one["data_sha256"]), str(other["data_sha256"]))
        found[f"{name}: flights compared on"] = ", ".join(c.test.flights)
        found[f"{name}: held-out sha256"] = c.test_hash
    for library in dict.fromkeys((*a.versions, *b.versions)):
        versions = [run.versions.get(library, "none") for run in (a, b)]
        found |= _both_say(f"version of {library}", *versions)
    return found


def _both_say(label: str, a: str, b: str) -> dict[str, str]:
    """One fact of both runs, or one of each where they differ."""
    return {label: a} if a == b else {f"{label} (run A)": a, f"{label} (run B)": b}


def _seconds(run: str, item: HeldOut) -> dict[str, float]:
    """Wall time of every fit, by the name its model has here."""
    return {f"{run}:{label}": t for label, t in item.channel.fit_seconds.items() if label in item.models}


def _names(named: Mapping[str, object]) -> str:
    return ", ".join(named) or "none"
