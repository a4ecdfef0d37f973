"""One model of a run: fitted, saved, its rules in words beside it; or why it could not be fitted."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, TypeVar

from flysid.dataset import Dataset
from flysid.errors import DataError, FitError
from flysid.files import write_atomically
from flysid.ingest.align.recipe import QUICK
from flysid.model.base import Fitted
from flysid.model.capabilities import HasOperatingPoints, LinearModel
from flysid.model.rules import phrases as words
from flysid.model.rules.operating_words import sentences
from flysid.validate.beyond import caution
from flysid.validate.responses import answers

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


def nothing_done(recipe: str, done: str, why: Mapping[str, str]) -> DataError:
    """No channel of a recipe could be `done`: every reason and every advice is said once.

    Parameters
    ----------
    recipe : its name; "" where there is none.
    why : channel -> the reason, as the text of an error: its advice goes into the hint.
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


def fit_one(estimator: FitsTo[S], train: S, path: Path) -> Fitted | str:
    """Fit and save a model, and its rules in words beside it; or why it could not be fitted."""
    try:
        model = estimator.fit(train)
    except UNFIT as error:
        return reason(error)
    if isinstance(train, Dataset):
        model = caution(model, train)
    model.save(path)
    write_atomically(path.with_suffix(".txt"), in_words(model).encode())
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
