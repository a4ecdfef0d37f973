"""Few flights, all used: every flight is judged by models that were fitted to the others.

Where fewer than five flights would be held out and at least five exist, the flights are left out in turn, in
five folds; every fold chooses delays, orders and rules anew. The verdict then rests on all flights. The
models of the run stay those of the split; the folds' models are kept beside them, to be judged again later.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from flysid.dataset import Dataset
from flysid.files import slug
from flysid.model.base import Estimator, Fitted
from flysid.progress import tell
from flysid.split import Split, plan_folds
from flysid.validate.compare.intervals import FEW
from flysid.validate.runs.fitone import UNFIT, fitted
from flysid.validate.runs.fitplan import FitPlan
from flysid.validate.runs.run import FitSettings, FoldRun

FOLDS = 5

Estimators = Callable[[Dataset], Mapping[str, Estimator]]


def are_needed(split: Split, data: Dataset, settings: FitSettings) -> bool:
    """Whether the split holds out too few flights, and there are enough to take turns."""
    held = {data.segments[p.segment].flight for p in split.test}
    return (
        settings.rotate
        and not settings.held
        and split.by == "flight"
        and len(held) <= FEW < len(data.flights)
    )


def fitted_in_turn(
    data: Dataset,
    estimators: Estimators,
    folder: Path,
    seed: int,
    plan: FitPlan,
    compared: Collection[str] = (),
) -> tuple[FoldRun, ...]:
    """Leave every flight out once, fit to the others, save; a model that a fold cannot fit is left out of it.

    `estimators`: what to fit to the training part of a fold, by label.
    `folder`: the run's, with the channel's own in it.
    `plan`: of the channel's work, of which this is a part.
    `compared`: labels of linear models, which come first; see `fitone.fitted`.
    """
    found = []
    for number, split in enumerate(plan_folds(data, FOLDS, seed=seed), start=1):
        place = f"{slug(data.name)}/fold-{number}"
        (folder / place).mkdir()
        train, _ = split.apply(data)
        files = {}
        beside: dict[str, Fitted] = {}
        for label, estimator in estimators(train).items():
            try:
                with plan.model(label, number):
                    tell(f"without fold {number} of {FOLDS}", share=0.0)
                    model = fitted(estimator, train, beside)
            except UNFIT:
                continue
            if label in compared:
                beside[label] = model
            files[label] = f"{place}/{label}.json"
            model.save(folder / files[label])
        found.append(FoldRun(split.to_dict(), files))
    return tuple(found)
