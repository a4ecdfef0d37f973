"""The page as a finished document: no model and no flight is left in it, and it is filled in without them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass

from flysid.dataset import Dataset
from flysid.model.base import Fitted
from flysid.validate.show.page.describe import describe
from flysid.validate.show.page.page import fill, render
from tests.validate.show.page.test_report import context


def held_by(value: object) -> Iterator[object]:
    """A value and all that it holds."""
    yield value
    inner: Sequence[object] = ()
    if is_dataclass(value):
        inner = [getattr(value, f.name) for f in fields(value)]
    elif isinstance(value, Mapping):
        inner = [*value, *value.values()]
    elif isinstance(value, Sequence) and not isinstance(value, str | bytes):
        inner = value
    for part in inner:
        yield from held_by(part)


def test_a_context_holds_models_and_its_page_none() -> None:
    found = context()
    models = list(next(iter(found.comparisons.values())).fitted.values())
    assert all(any(part is model for part in held_by(found)) for model in models)
    page = describe(found)
    parts = list(held_by(page))
    assert len(parts) > 1000
    assert not [part for part in parts if isinstance(part, Fitted | Dataset)]


def test_a_page_is_filled_in_from_what_it_holds() -> None:
    page = describe(context())
    assert fill(page, ()) == fill(page, ()) == render(context())
    assert "The picture of roll is missing." in fill(page, ["The picture of roll is missing."])
