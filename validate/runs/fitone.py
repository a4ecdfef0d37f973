"""One model of a run: fitted, saved, its rules in words beside it; or why it could not be fitted."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

from flysid.dataset import Dataset
from flysid.errors import DataError, FitError
from flysid.extras import Extra, extra
from flysid.files import write_atomically
from flysid.ingest.align.recipe import QUICK
from flysid.model.base import Fitted
from flysid.model.capabilities import HasOperatingPoints, LinearModel
from flysid.model.last_gates import refuse
from flysid.model.rules import phrases as words
from flysid.model.rules.operating_words import sentences
from flysid.model.selection import LEVEL, MARGIN
from flysid.model.structures import all_structures, row_of
from flysid.validate.diagnose.beyond import caution
from flysid.validate.diagnose.responses import answers

S = TypeVar("S", contravariant=True)

UNFIT = (DataError, FitError, MemoryError)
"""What keeps a model or a channel from being fitted, and nothing beside it."""


def reason(error: Exception) -> str:
    """Why something could not be fitted, for people; where memory was lacking, with what to try."""
    said = str(error)
    if isinstance(error, MemoryError):
        said = f"out of memory: {said}" if said else "out of memory"
    elif not isinstance(error.__cause__, MemoryError):
        return said
    return f"{said}. Try: fewer --jobs at a time, or a smaller --memory, which fits from disk"


def fault(error: Exception, package: str = "") -> str:
    """What broke inside flysid, or in the package of a structure, and where, for a report."""
    at = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(at.filename).parent.name}/{Path(at.filename).name}, line {at.lineno}"
    if package:
        return (
            f"the package {package} failed: {type(error).__name__}: {error} ({place}). Try: upgrade it, or "
            "report this to whoever maintains it"
        )
    return (
        f"flysid itself failed: {type(error).__name__}: {error} ({place}). Try: report this as a bug, with "
        "the data if you may"
    )


def nothing_done(recipe: str, done: str, why: Mapping[str, str]) -> DataError:
    """No channel of a recipe could be `done`: every reason and every advice stands once.

    `recipe`: its name; "" where there is none.
    `why`: channel -> the reason, as the text of an error: its advice goes into the hint.
    """
    said: dict[str, list[str]] = {}
    hints: dict[str, None] = {}
    for name, text in why.items():
        cause, _, hint = text.removeprefix(f"channel {name!r}").partition(" Try: ")
        said.setdefault(cause.lstrip(": "), []).append(name)
        hints |= {hint: None} if hint else {}
    reasons = "; ".join(f"{', '.join(names)}: {cause}" for cause, names in said.items())
    of_recipe = "" if recipe in ("", QUICK) else f" of recipe {recipe!r}"
    return DataError(f"no channel{of_recipe} could be {done}: {reasons}", hint="; ".join(hints))


class FitsTo(Protocol[S]):
    """An estimator of data in memory, or of data on disk."""

    def fit(self, train: S) -> Fitted: ...


def fitted(estimator: FitsTo[S], train: S, beside: Mapping[str, Fitted]) -> Fitted:
    """A model that passes the last gates (`flysid.model.last_gates`).

    With a memory it may not err more on its training data than the linear models `beside`, by their labels: a
    linear one by `MARGIN`, any other by `LEVEL`. Equations of a vehicle, whose form the user knows, may
    (`flysid.model.structures.Structure.gate`). Raises FitError: it does, or nothing could be fitted.
    Raises DataError, MemoryError: nothing could be fitted.
    """
    model = estimator.fit(train)
    if model.structure not in all_structures():
        raise FitError(f"its models call themselves {model.structure!r}, and no installed structure does")
    row = row_of(model.structure)
    if row.gate == "nothing" or not isinstance(train, Dataset):
        return model
    if row.gate == "held value":
        return refuse(model, {}, train)
    margin = MARGIN if row.kind == "linear" else LEVEL
    named = {label.upper(): other for label, other in beside.items()}
    return refuse(model, named, train, margin)


def fit_one(estimator: FitsTo[S], train: S, path: Path, beside: Mapping[str, Fitted]) -> Fitted | str:
    """Fit and save a model, and its rules in words beside it; or why it could not be fitted."""
    try:
        model = fitted(estimator, train, beside)
    except UNFIT as error:
        return reason(error)
    except Exception as error:  # noqa: BLE001 - one structure takes no other model of the run down
        return fault(error, row_of(path.stem).package)
    of = f"{path.stem} on {path.parent.name}"
    if isinstance(train, Dataset):
        model = extra(Extra.BEYOND, partial(caution, model, train), model, of)
    model.save(path)
    text = extra(Extra.MODEL_TEXT, partial(in_words, model), "", of)
    if text:
        write_atomically(path.with_suffix(".txt"), text.encode())
    return model


def in_words(model: Fitted) -> str:
    """A model's rules with what they mean, a line each, and how it was chosen."""
    rules = model.rules()
    count = f" {len(rules)} rules," if len(rules) > 1 else ""
    title = f"{model.structure},{count} {model.n_parameters} parameters"
    points = model.operating_points if isinstance(model, HasOperatingPoints) else ()
    if isinstance(model, LinearModel):
        points = answers(model)
    signals = model.outputs, model.inputs
    return words.in_words(title, rules, model.notes, signals, sentences(points, signals)) + "\n"
