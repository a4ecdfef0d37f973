"""`flysid.compare`: fitted models against each other, as a comparison that renders itself."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from flysid.dataset import Dataset
from flysid.model.base import Fitted
from flysid.validate.compare.models import HORIZONS, Turn, compare_models
from flysid.validate.show.shown import ShownComparison


def compare(
    models: Sequence[Fitted] | Mapping[str, Fitted],
    test: Dataset,
    *,
    horizons: Sequence[str | int] = HORIZONS,
    baseline: str | None = None,
    contender: str | None = None,
    train: Dataset | None = None,
    seen: Collection[str] = (),
    turns: Sequence[Turn] = (),
) -> ShownComparison:
    """Compare fitted models on held-out data.

    Where the models have seen no held-out flight, the verdict is of *another flight*, one *like these* or *of
    this day*, and flights are its units; else of *these flights*, *the held-out flight* or *this flight*, and
    its units are blocks of time.

    Parameters
    ----------
    models : by name, or a list (named by structure: "arx", "ts", "ts-2", ...).
    test : the held-out part; nothing is fitted to it.
    horizons : "free_run" and numbers of steps.
    baseline : the model the others are compared with. When None, the linear one whose free run follows
        `train` best (ARX unless another is clearly better); without `train` ARX, else the first model.
        `flysid validate` names the one that the run's fit chose.
    contender : the model the headline speaks of; when None, the first of `structures.leaders()`, else the
        first model that is no reference, a line last.
    train : training data; with it the mean and persistence stand beside the models.
    seen : flights that the models were trained on, besides those of `train`.
    turns : models fitted in the same way to all flights but some, and those; verdicts and changes rest on
        them where every turn has both models, scores and figures on `models` and `test`.

    Raises
    ------
    UsageError : a model does not belong to the data, or the baseline is not among the models.
    DataError : no segment is long enough to score.

    Examples
    --------
    >>> fitted, held_out = train.split(holdout=0.3)  # train: see `flysid.Dataset`
    >>> arx = flysid.ARX(na=1, nb=1, nk=1, refine=False).fit(fitted)
    >>> result = flysid.compare([arx, flysid.Line().fit(fitted)], held_out)
    >>> str(result.verdict["y"].verdict)
    'worse'
    """
    found = compare_models(
        models,
        test,
        horizons=horizons,
        baseline=baseline,
        contender=contender,
        train=train,
        seen=seen,
        turns=turns,
    )
    return ShownComparison.of(found)
