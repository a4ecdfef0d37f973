"""Channels that do not fit into memory: fitted from disk, in bounded memory, by the models that can.

What a model chooses (orders, delays) it chooses on the first samples; its coefficients are fitted to all of
them. Structures that search on the simulation error need their data in memory and say so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from flysid.datasetfile import DatasetFile
from flysid.ingest.excitation.dead_time import dead_times, delays_to_try
from flysid.model.linear_choice import best_fitted
from flysid.progress import tell
from flysid.validate.channeljob import ChannelJob, Fits
from flysid.validate.diskparts import LOOK_ROWS, FilePart, plan_held_on_disk, plan_on_disk
from flysid.validate.fitplan import FitPlan
from flysid.validate.run import ChannelRun

STREAMED = ("arx", "fir", "iv", "statespace")
"""Labels of the models that read their data block by block."""


def streaming_estimators(labels: Sequence[str], nk_hint: tuple[int, ...] = ()) -> dict[str, Any]:
    """Those of the models that can be fitted from disk, by label; ARX always."""
    from flysid.model.arx import ARX
    from flysid.model.fir import FIR
    from flysid.model.iv import IV
    from flysid.model.mean import Mean
    from flysid.model.persistence import Persistence
    from flysid.model.statespace import StateSpace

    known = {
        "mean": Mean(),
        "persistence": Persistence(),
        "arx": ARX(nk_hint=nk_hint),
        "fir": FIR(),
        "iv": IV(nk_hint=nk_hint),
        "statespace": StateSpace(nk_hint=nk_hint),
    }
    wanted = {"mean", "persistence", "arx", *(labels or STREAMED)}
    return {label: estimator for label, estimator in known.items() if label in wanted}


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
        hint = delays_to_try(late, len(look.inputs))
        wanted = streaming_estimators(settings.labels, hint)
        plan = FitPlan(tuple(wanted))
        fits = Fits(failed={n: self._cannot() for n in settings.labels if n not in STREAMED})
        told: ChannelRun | None = None
        for label, estimator in wanted.items():
            with plan.model(label):
                self.fit_into(fits, label, estimator, train, ())
                linear = {label: model for label, model in fits.models.items() if label in STREAMED}
                if linear:  # all were fitted to many more samples than these: none knows them by heart
                    told = replace(
                        self.told(fits, best_fitted(linear, look), split, look, late), on_disk=True
                    )
                tell("could not be fitted" if label in fits.failed else "fitted", share=1.0, result=told)
        return told or fits.reasons

    def _cannot(self) -> str:
        return (
            f"needs its data in memory, and these {len(self.data):,} samples were fitted from disk (allow "
            "more with --memory, or fit some of the flights)"
        )
