"""From an ingested folder and a recipe to a run: every channel aligned, split and fitted.

Channels are independent of each other, so they are fitted side by side in processes of their own; the
result does not depend on how many.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from flysid.dataset import Dataset
from flysid.datasetfile import open_dataset
from flysid.errors import DataError, UsageError
from flysid.extras import Extra, Missing, extra
from flysid.files import replacing_folder, slug, write_atomically
from flysid.ingest.align.doubts import doubts
from flysid.ingest.align.recipe import Recipe, load_recipe, recipe_text
from flysid.ingest.excitation.dead_time import dead_times
from flysid.ingest.kinematics.telling import Instruments
from flysid.ingest.lake.chosen_flights import whole_ids
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.stretches import held_spans
from flysid.ingest.lake.workers import Bounds, Lost, run_bounded
from flysid.model.base import Estimator
from flysid.model.linear_choice import FIRST, choose_baseline, confirm
from flysid.model.one_rule import linear_rivals
from flysid.model.rules.search_settings import SearchSettings
from flysid.model.shared import sharing
from flysid.model.structures import OWN
from flysid.progress import Step, tell, through
from flysid.split import plan_held, plan_split
from flysid.validate.runs import folds
from flysid.validate.runs.channeljob import ChannelJob, Fits
from flysid.validate.runs.diskparts import LOOK_ROWS
from flysid.validate.runs.fitdisk import DiskJob
from flysid.validate.runs.fitone import nothing_done, reason
from flysid.validate.runs.fitplan import CHOICE, FitPlan
from flysid.validate.runs.run import (
    RECIPE_FILE,
    RUN_FILE,
    ChannelRun,
    FitSettings,
    Run,
    run_document,
    versions,
)
from flysid.validate.runs.wanted_models import (
    check_settings,
    delays_of,
    estimators,
    files_of,
    refused_antecedents,
)

FROM_DISK = " from disk: it has more samples than may be in memory (--memory)"


def _keep_files(folder: Path, settings: FitSettings) -> None:
    """The files of models beside the recipe: what a run holds is enough to make it again."""
    for label, file in files_of(settings).items():
        write_atomically(folder / f"{label}{file.suffix}", file.read_bytes())


class MemoryJob(ChannelJob[Dataset]):
    """One channel to fit in memory."""

    def _run(self) -> ChannelRun | str:
        with sharing():
            return self._share()

    def _share(self) -> ChannelRun | str:
        settings = self.settings
        split = (
            plan_held(self.data, self.held, seed=settings.seed)
            if self.held
            else plan_split(self.data, holdout=settings.holdout, by=settings.by, seed=settings.seed)
        )
        train, _ = split.apply(self.data)
        turns = folds.FOLDS if folds.are_needed(split, self.data, settings) else 0
        plan = FitPlan(tuple(estimators(settings)), turns)
        with plan.choice():
            tell("looking for dead times", share=0.0)
            late = dead_times(train)
            delays = delays_of(late, train)
            started = time.perf_counter()
            search = SearchSettings.of(settings.effort)
            choice = choose_baseline(train, linear_rivals(*delays, search, settings.own_constants))
            fits = Fits(seconds={CHOICE: time.perf_counter() - started})
        wanted = estimators(settings, choice.label, delays)
        plan = FitPlan(tuple(wanted), turns)
        beside = [label for label in wanted if label == choice.label or label in _linear_of_every_run()]
        first = list(wanted)[: 1 + list(wanted).index(beside[-1])]
        for label in first:
            with plan.model(label):
                self.fit_into(fits, label, wanted[label], train, [FIRST])
        linear = {label: model for label, model in fits.models.items() if label in beside}
        if not linear:
            return fits.reasons
        told = self.channel_run(fits, confirm(choice, linear, train), split, train, late)
        tell(
            "best linear model",
            model=told.baseline,
            validation=choice.rmse.get(told.baseline),
            result=_so_far(told, wanted),
        )
        for label in list(wanted)[len(first) :]:
            with plan.model(label):
                self.fit_into(fits, label, wanted[label], train, [FIRST, told.baseline])
                told = replace(
                    told, models=dict(fits.files), fit_seconds=dict(fits.seconds), failed=dict(fits.failed)
                )
                tell(
                    "could not be fitted" if label in fits.failed else "fitted",
                    share=1.0,
                    result=_so_far(told, wanted),
                )
        if not turns:
            return told
        started = time.perf_counter()
        anew = partial(_of_a_fold, settings, fits)
        compared = (FIRST, told.baseline)
        found = folds.fitted_in_turn(self.data, anew, self.folder, settings.seed, plan, compared)
        spent = {"all flights in turn": time.perf_counter() - started}
        return replace(told, folds=found, fit_seconds=fits.seconds | spent)


def _linear_of_every_run() -> list[str]:
    """Models that every run holds, whichever is the baseline."""
    return [row.name for row in OWN.values() if row.fitted == "always" and row.kind == "linear"]


def _so_far(channel: ChannelRun, labels: Iterable[str]) -> ChannelRun:
    """What is left of a channel if the work ends here."""
    missing = {label: "the fit was interrupted" for label in labels if label not in channel.models}
    return replace(channel, failed=missing | dict(channel.failed))


def _of_a_fold(settings: FitSettings, fits: Fits, train: Dataset) -> dict[str, Estimator]:
    """The run's models again, with the delays that this fold's training part speaks for."""
    delays = delays_of(dead_times(train), train)
    every = {
        **linear_rivals(*delays, SearchSettings.of(settings.effort), settings.own_constants),
        **estimators(settings, FIRST, delays),
    }
    return {label: estimator for label, estimator in every.items() if label in fits.models}


def fit_run(
    lake: Lake,
    recipe_name: str,
    out: Path,
    settings: FitSettings,
    *,
    jobs: int = 1,
) -> Run:
    """Fit every channel of a recipe and write the run folder; tells of its progress (`flysid.progress`).

    A channel that cannot be fitted is skipped with its reason (`Run.skipped`). One with more samples than may
    be in memory is fitted from disk, by the models that can. Where KeyboardInterrupt ends it after the linear
    models of a channel, the run holds what was finished, and `Run.interrupted` is set.

    `recipe_name`: a shipped recipe, or the path of one.
    `out`: the run's folder; what is there is replaced once the run is complete.
    `jobs`: channels fitted at a time, each in a process of its own where more than one.
    Raises DataError: no channel could be fitted; the message gives each channel's reason. Raises RecipeError:
    the recipe names what the data does not hold. Raises UsageError: `settings.channels` names a channel that
    the recipe does not have; `settings.held` a flight that is not among the chosen ones.
    """
    check_settings(settings)
    settings = replace(
        settings,
        selection=replace(settings.selection, stretches=lake.stretches),
        held=whole_ids(lake, settings.held),
    )
    held = held_spans(lake.logs, settings.held)
    recipe = load_recipe(recipe_name)
    served = lake.channels(recipe)
    skipped = {
        name: "no flight holds its streams"
        for name in (recipe.channels if served and not settings.channels else ())
        if name not in served
    }
    wanted = [n for n in recipe.chosen(settings.channels) if n not in skipped]
    skipped |= {n: str(why) for n, why in refused_antecedents(settings.antecedents, recipe, wanted).items()}
    wanted = [n for n in wanted if n not in skipped]
    with replacing_folder(out) as folder:
        queue: list[MemoryJob | DiskJob] = []
        with tempfile.TemporaryDirectory(prefix=".aligned-", dir=folder) as scratch:
            places = Places(folder, Path(scratch), Instruments(lake.logs))
            for name in wanted:
                tell("aligning", channel=name, share=0.0)
                try:
                    queue.append(replace(_job(lake, recipe, name, places, settings), held=held))
                except (DataError, MemoryError) as error:
                    skipped[name] = reason(error)
            found, interrupted = _fit(queue, jobs)
        fitted = [c for c in map(found.get, wanted) if isinstance(c, ChannelRun)]
        skipped |= {name: str(why) for name, why in found.items() if not isinstance(why, ChannelRun)}
        if interrupted:
            _drop_unfinished(folder, fitted)
        if not fitted:
            raise nothing_done(recipe.name, "fitted", skipped)
        run = Run(
            folder=out,
            data=lake.place,
            recipe=recipe.name,
            flights=tuple(f.id for f in lake.facts),
            settings=settings,
            channels=tuple(fitted),
            skipped=skipped,
            versions=versions(),
            interrupted=interrupted,
        )
        _keep_files(folder, settings)
        write_atomically(folder / RECIPE_FILE, recipe_text(recipe_name)[0].encode())
        write_atomically(folder / RUN_FILE, run_document(run))
    return run


def fit_file(path: Path, out: Path, settings: FitSettings) -> Run:
    """Fit the one channel that a dataset file holds (`flysid.datasetfile`) and write the run folder.

    Tells of its progress, and may be interrupted, as `fit_run`. Raises DataError: nothing can be fitted.
    Raises StoreError: not a dataset file, or damaged. Raises UsageError: `settings` names a channel or a
    model that is not there.
    """
    check_settings(settings)
    if settings.held:
        raise UsageError("the flights of a dataset file are held out by chance", hint="--holdout SHARE")
    file = open_dataset(path)
    for name in settings.channels:
        if name != file.name:
            raise UsageError(f"the dataset file is of channel {file.name!r}, not {name!r}", path=path)
    with replacing_folder(out) as folder:
        large = _megabytes(len(file), len(file.inputs) + len(file.outputs)) > settings.memory_mb
        job = DiskJob(file, folder, settings) if large else MemoryJob(file.read(), folder, settings)
        found, interrupted = _fit([job], 1)
        channel = found[job.name]
        if isinstance(channel, str):
            raise DataError(f"{job.name!r} could not be fitted: {channel}", path=path)
        if interrupted:
            _drop_unfinished(folder, [channel])
        flights = tuple(dict.fromkeys(e.flight for e in file.entries))
        run = Run(out, os.path.abspath(path), "", flights, settings, (channel,), {}, versions(), interrupted)
        _keep_files(folder, settings)
        write_atomically(folder / RUN_FILE, run_document(run))
    return run


def _drop_unfinished(folder: Path, channels: Sequence[ChannelRun]) -> None:
    """Remove the files of models that were at work when the fit was interrupted."""
    models = [file for c in channels for file in c.models.values()]
    models += [file for c in channels for fold in c.folds for file in fold.models.values()]
    named = {path for file in models for path in (folder / file, (folder / file).with_suffix(".txt"))}
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_dir():
            with suppress(OSError):  # it holds models
                path.rmdir()
        elif path not in named:
            path.unlink()


@dataclass(frozen=True)
class Places:
    """Where a run is made, where aligned channels lie meanwhile, and what is known of their instruments."""

    run: Path
    scratch: Path
    instruments: Instruments


def _job(lake: Lake, recipe: Recipe, name: str, places: Places, settings: FitSettings) -> MemoryJob | DiskJob:
    """A channel to fit, with the doubts about its data."""
    missing = Missing()
    with missing.gathering():
        job = _aligned(lake, recipe, name, places, settings)
        more = extra(Extra.INSTRUMENTS, partial(places.instruments.doubts, recipe, name), (), name)
    return replace(job, doubts=(*job.doubts, *more), missing=missing.sentences)


def _aligned(
    lake: Lake, recipe: Recipe, name: str, places: Places, settings: FitSettings
) -> MemoryJob | DiskJob:
    """In memory, or into a file where there are more samples than may be in memory."""
    signals = len(recipe.signals_of(name))
    if _megabytes(lake.expected_samples(recipe, name), signals) <= settings.memory_mb:
        aligned = lake.align(recipe, name)
        lines = tuple(aligned.report.lines())
        return MemoryJob(aligned.dataset, places.run, settings, lines, aligned.report.doubts)
    path = places.scratch / f"{slug(name)}.parquet"
    report = lake.write(recipe, name, path)
    file = open_dataset(path)
    look = partial(doubts, file.head(LOOK_ROWS), recipe.channel(name))
    found = extra(Extra.DOUBTS, look, (), name) if len(file) else ()
    return DiskJob(file, places.run, settings, tuple(report.lines()), found)


def _megabytes(samples: int, signals: int) -> float:
    """Of so many samples in memory."""
    return 8e-6 * samples * signals


def _fit(queue: Sequence[MemoryJob | DiskJob], jobs: int) -> tuple[dict[str, ChannelRun | str], bool]:
    """Every channel's run, or why there is none; and whether a keyboard's interrupt cut the work short."""
    found: dict[str, ChannelRun | str] = {}
    finished: dict[str, ChannelRun] = {}
    shares = {job.name: 0.0 for job in queue}

    def placed(step: Step) -> Step:
        """The share of all channels."""
        if isinstance(step.result, ChannelRun):
            finished[step.channel] = step.result
        if step.share is not None:
            shares[step.channel] = step.share
        return replace(step, share=sum(shares.values()) / len(shares), result=None)

    with through(placed):
        for job in queue:
            tell("waiting" + (FROM_DISK if isinstance(job, DiskJob) else ""), channel=job.name, share=0.0)
        try:
            for name, outcome in _outcomes(queue, jobs):
                found[name] = outcome
                tell("done" if isinstance(outcome, ChannelRun) else outcome, channel=name, share=1.0)
        except KeyboardInterrupt:
            if not found and not finished:
                raise
            unfinished = {job.name: "interrupted before its linear models were fitted" for job in queue}
            return unfinished | finished | found, True
    return found, False


def _outcomes(queue: Sequence[MemoryJob | DiskJob], jobs: int) -> Iterator[tuple[str, ChannelRun | str]]:
    """(channel, its run or why there is none), in the order in which they are done."""
    if min(jobs, len(queue)) <= 1:
        yield from ((job.name, job.run()) for job in queue)
        return
    for job, found in run_bounded(_run, queue, min(jobs, len(queue)), Bounds(None, None)):
        yield job.name, found.reason if isinstance(found, Lost) else found


def _run(job: MemoryJob | DiskJob) -> ChannelRun | str:
    return job.run()
