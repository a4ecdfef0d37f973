"""Channels that do not fit into memory: fitted from disk, in bounded memory, by the models that can.

What a model chooses (orders, delays) it chooses on the first samples; its coefficients are fitted to all of
them. Structures that search on the simulation error need their data in memory and say so.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from flysid.dataset import Dataset
from flysid.datasetfile import DatasetFile
from flysid.errors import DataError, FitError
from flysid.flightwriter import slug
from flysid.ingest.deadtime import dead_times, delays_to_try
from flysid.ingest.doubts import Doubt
from flysid.model.base import Fitted
from flysid.model.feedback import feedback
from flysid.model.selection import clearly_better
from flysid.validate.baseline import Choice, free_run_errors
from flysid.validate.diskparts import LOOK_ROWS, FilePart, plan_on_disk
from flysid.validate.fitone import fit_one
from flysid.validate.run import ChannelRun, FitSettings

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


@dataclass(frozen=True)
class DiskJob:
    """One channel to fit from disk: what a worker process needs."""

    file: DatasetFile
    folder: Path
    settings: FitSettings
    lines: tuple[str, ...] = ()
    doubts: tuple[Doubt, ...] = ()

    @property
    def name(self) -> str:
        return self.file.name

    def run(self) -> ChannelRun | str:
        """Split, fit and save; or the reason why nothing can be fitted."""
        try:
            return self._run()
        except (DataError, FitError) as error:
            return str(error)

    def _run(self) -> ChannelRun | str:
        settings, place = self.settings, slug(self.name)
        split = plan_on_disk(self.file, holdout=settings.holdout, by=settings.by, seed=settings.seed)
        train = FilePart(self.file, split.train)
        look = train.head(LOOK_ROWS)
        (self.folder / place).mkdir()
        late = dead_times(look)
        hint = delays_to_try(late, len(look.inputs))
        files: dict[str, str] = {}
        seconds: dict[str, float] = {}
        linear: dict[str, Fitted] = {}
        failed = {label: self._cannot() for label in settings.models if label not in STREAMED}
        for label, estimator in streaming_estimators(settings.models, hint).items():
            started = time.perf_counter()
            model = fit_one(estimator, train, self.folder / f"{place}/{label}.json")
            if isinstance(model, str):
                failed[label] = model
                continue
            seconds[label] = time.perf_counter() - started
            files[label] = f"{place}/{label}.json"
            if label in STREAMED:
                linear[label] = model
        if not linear:
            return "; ".join(f"{label}: {why}" for label, why in failed.items())
        choice = _baseline(linear, look)
        return ChannelRun(
            name=self.name,
            models=files,
            split=split.to_dict(),
            aligned=self.lines,
            fit_seconds=seconds,
            failed=failed,
            doubts=self.doubts,
            dead_times=tuple(d.words for d in late),
            loops=tuple(f.words for f in feedback(linear[choice.label], look) if f.closed),
            baseline=choice.label,
            chosen=choice.words,
            on_disk=True,
        )

    def _cannot(self) -> str:
        return (
            f"needs its data in memory, and these {len(self.file):,} samples were fitted from disk (allow "
            "more with --memory, or fit some of the flights)"
        )


def _baseline(models: dict[str, Fitted], look: Dataset) -> Choice:
    """ARX, unless another model free-runs the first training samples better.

    All were fitted to many more samples than these, so that none knows them by heart.
    """
    errors = free_run_errors(models, look)
    label = "arx" if "arx" in errors else next(iter(errors))
    for name, e in errors.items():
        label = name if clearly_better(e, errors[label]) else label
    rmse = {name: float(np.sqrt(e.mean())) for name, e in errors.items()}
    said = ", ".join(f"{name.upper()} {value:.3g}" for name, value in rmse.items())
    words = f"free-run RMSE over the first {len(look):,} training samples, in standard deviations: {said}"
    return Choice(label, rmse, words)
