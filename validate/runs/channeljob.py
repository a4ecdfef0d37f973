"""One channel to fit, in memory or from disk: what a worker process needs, and what comes of it."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

from flysid.dataset import Dataset
from flysid.datasetfile import DatasetFile
from flysid.extras import Extra, Missing, extra
from flysid.feedback import feedback
from flysid.files import slug
from flysid.ingest.align.doubts import Doubt
from flysid.ingest.excitation.dead_time import DeadTime
from flysid.model.base import Fitted
from flysid.model.linear_choice import BaselineChoice
from flysid.model.nonlinearity import nonlinearity
from flysid.progress import part, tell
from flysid.split import Split
from flysid.validate.runs.fitone import UNFIT, FitsTo, fit_one, reason
from flysid.validate.runs.run import ChannelRun, FitSettings

D = TypeVar("D", Dataset, DatasetFile)
S = TypeVar("S")


@dataclass
class Fits:
    """What came of a channel's models, by label: those fitted, their files and wall times, why not others."""

    models: dict[str, Fitted] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    @property
    def reasons(self) -> str:
        """Why models could not be fitted, in one line."""
        return "; ".join(f"{label}: {why}" for label, why in self.failed.items())


@dataclass(frozen=True)
class ChannelJob(Generic[D]):
    """One channel to fit.

    `data`: the whole channel.
    `folder`: the run's; models go into a folder of the channel's name in it.
    `lines`, `doubts`: how the channel was aligned, and reasons in the data not to trust any model of it.
    `held`: flight -> spans of vehicle time, ns, that are held out; a share by chance where there are none.
    `missing`: sentences on extras of the data that could not be given.
    """

    data: D
    folder: Path
    settings: FitSettings
    lines: tuple[str, ...] = ()
    doubts: tuple[Doubt, ...] = ()
    held: Mapping[str, Sequence[tuple[int, int]]] = field(default_factory=dict)
    missing: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The channel's."""
        return self.data.name

    def run(self) -> ChannelRun | str:
        """Split, fit and save; or the reason why nothing can be fitted: one channel takes no other along."""
        missing = Missing(*self.missing)
        try:
            with part(channel=self.name), missing.gathering():
                found = self._run()
        except UNFIT as error:
            return reason(error)
        return found if isinstance(found, str) else replace(found, missing=missing.sentences)

    def _run(self) -> ChannelRun | str:
        raise NotImplementedError

    def fit_into(
        self, fits: Fits, label: str, estimator: FitsTo[S], train: S, beside: Collection[str]
    ) -> None:
        """Fit and save a model; one that cannot be fitted leaves a reason.

        `beside`: labels of linear models that it is compared with, as far as they are fitted.
        """
        tell("fitting", share=0.0)
        started = time.perf_counter()
        place = slug(self.name)
        (self.folder / place).mkdir(exist_ok=True)
        file = f"{place}/{label}.json"
        known = {name: fits.models[name] for name in beside if name in fits.models}
        model = fit_one(estimator, train, self.folder / file, known)
        if isinstance(model, str):
            fits.failed[label] = model
        else:
            fits.seconds[label] = time.perf_counter() - started
            fits.models[label] = model
            fits.files[label] = file

    def channel_run(
        self, fits: Fits, choice: BaselineChoice, split: Split, seen: Dataset, late: tuple[DeadTime, ...]
    ) -> ChannelRun:
        """What the run remembers of the channel.

        `choice`: of the baseline, one of `fits.models`.
        `seen`: training samples, in which a loop is looked for.
        `late`: dead times found in training.
        """
        baseline = fits.models[choice.label]
        return ChannelRun(
            name=self.name,
            models=fits.files,
            split=split.to_dict(),
            aligned=self.lines,
            fit_seconds=fits.seconds,
            failed=fits.failed,
            doubts=self.doubts,
            dead_times=tuple(d.words for d in late),
            loops=extra(Extra.LOOP, partial(_loops, seen), (), self.name),
            nonlinear=extra(Extra.NONLINEARITY, partial(_nonlinear, baseline, seen), (), self.name),
            baseline=choice.label,
            chosen=choice.words,
        )


def _loops(seen: Dataset) -> tuple[str, ...]:
    """A sentence for each output that an input answers."""
    return tuple(f.words for f in feedback(seen) if f.closed)


def _nonlinear(baseline: Fitted, seen: Dataset) -> tuple[str, ...]:
    """A sentence for each output; none where memory is short: no model is lost for it."""
    try:
        return tuple(n.words for n in nonlinearity(baseline, seen) if n.words)
    except MemoryError:
        return ()
