"""Channels that do not fit into memory: fitted from disk, in bounded memory, by the models that can.

What a model chooses (orders, delays) it chooses on the first samples; its coefficients are fitted to all of
them. Structures that search on the simulation error need their data in memory and say so.
"""

from __future__ import annotations

from dataclasses import replace

from flysid.datasetfile import DatasetFile
from flysid.ingest.excitation.dead_time import dead_times
from flysid.model.linear_choice import best_fitted
from flysid.model.structures import kind_of
from flysid.progress import tell
from flysid.validate.runs.channeljob import ChannelJob, Fits
from flysid.validate.runs.diskparts import LOOK_ROWS, FilePart, plan_held_on_disk, plan_on_disk
from flysid.validate.runs.fitplan import FitPlan
from flysid.validate.runs.run import ChannelRun
from flysid.validate.runs.wanted_models import delays_of, streaming_estimators


class DiskJob(ChannelJob[DatasetFile]):
    """One channel to fit from disk."""

    def _run(self) -> ChannelRun | str:
        settings = self.settings
        split = (
            plan_held_on_disk(self.data, self.held, seed=settings.seed)
            if self.held
            else plan_on_disk(self.data, holdout=settings.holdout, by=settings.by, seed=settings.seed)
        )
        train = FilePart(self.data, split.train)
        look = train.head(LOOK_ROWS)
        late = dead_times(look)
        wanted = streaming_estimators(settings, delays_of(late, look))
        plan = FitPlan(tuple(wanted))
        fits = Fits(failed={n: self._cannot() for n in settings.labels if n not in wanted})
        told: ChannelRun | None = None
        for label, estimator in wanted.items():
            with plan.model(label):
                self.fit_into(fits, label, estimator, train, ())
                linear = {n: m for n, m in fits.models.items() if kind_of(m.structure) == "linear"}
                if linear:  # all were fitted to many more samples than these: none knows them by heart
                    told = replace(
                        self.channel_run(fits, best_fitted(linear, look), split, look, late), on_disk=True
                    )
                tell("could not be fitted" if label in fits.failed else "fitted", share=1.0, result=told)
        return told or fits.reasons

    def _cannot(self) -> str:
        return (
            f"needs its data in memory, and these {len(self.data):,} samples were fitted from disk (allow "
            "more with --memory, or fit some of the flights)"
        )
