"""Settings of models refuse what cannot be where they are made, not an hour later in a fit.

The types of a dataclass's fields say what each setting may be: `int | Literal["auto"]` is a whole number
from 0 on, or "auto". What types cannot say, such as a least number of rules, `check_values` adds.
"""

from __future__ import annotations

import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from math import isfinite
from typing import Any, Literal, Self, Union, get_args, get_origin, get_type_hints

import numpy as np

from flysid.errors import UsageError
from flysid.model.arguments import is_count
from flysid.showing import one_of


@dataclass(frozen=True)
class Settings:
    """Settings of a model, as a frozen dataclass whose fields are the settings.

    Raises
    ------
    UsageError : a name that is no setting, with the nearest one; a value that a setting cannot have.

    Examples
    --------
    >>> try:
    ...     flysid.TS(rule=2)
    ... except flysid.UsageError as error:
    ...     print(error.hint[-21:])
    did you mean 'rules'?
    >>> try:
    ...     flysid.TS(rules="two")
    ... except flysid.UsageError as error:
    ...     print(error)
    TS: rules is a whole number from 0 on or "auto", not 'two'.
    """

    def __new__(cls, *values: object, **named: object) -> Self:
        """Before Python looks at the names: it would list none of those that there are."""
        known = [field.name for field in fields(cls) if field.init]
        unknown = next((name for name in named if name not in known), None)
        if unknown is not None:
            hint = one_of(known, unknown) if known else "it has none"
            raise UsageError(f"{cls.__name__} has no setting {unknown!r}", hint=hint)
        if len(values) > len(known):
            raise UsageError(f"{cls.__name__} has {len(known)} settings, and {len(values)} values are given")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        for name, kind in _kinds(type(self)).items():  # type: ignore[arg-type]
            value = getattr(self, name)
            if not _is_a(value, kind):
                raise UsageError(f"{type(self).__name__}: {name} is {_in_words(kind)}, not {value!r}.")
        self.check_values()

    def check_values(self) -> None:
        """Raise UsageError for values of the right types that cannot be, whatever the data."""

    def at_least(self, least: int, *names: str) -> None:
        """Raise UsageError where one of these settings is a number below `least`."""
        for name in names:
            value = getattr(self, name)
            if isinstance(value, int | np.integer) and value < least:
                raise UsageError(f"{type(self).__name__}: {name} is at least {least}, not {value!r}.")


@cache
def _kinds(cls: type[Settings]) -> Mapping[str, Any]:
    """The type of every setting."""
    hints = get_type_hints(cls)
    return {field.name: hints[field.name] for field in fields(cls) if field.init}


def _is_a(value: Any, kind: Any) -> bool:
    """Whether a value is of a setting's type."""
    origin, of = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return any(_is_a(value, one) for one in of)
    if origin is Literal:
        return isinstance(value, str) and value in of
    if origin is tuple and of[-1] is not Ellipsis:
        return _is_sequence(value) and len(value) == len(of) and all(map(_is_a, value, of))
    if origin in (Sequence, tuple):
        return _is_sequence(value) and all(_is_a(one, of[0]) for one in value)
    if kind is bool:
        return isinstance(value, bool | np.bool_)
    if kind is int:
        return is_count(value, 0)
    if kind is float:
        return _is_number(value)
    return _is_instance(value, kind)


def _is_sequence(value: object) -> bool:
    return isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)


def _is_number(value: Any) -> bool:
    numeric = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return numeric and isfinite(value)


def _is_instance(value: object, kind: type) -> bool:
    """An object of a class; of a protocol, one that has its methods, and is not a class itself."""
    if not getattr(kind, "_is_protocol", False):
        return isinstance(value, kind)
    methods = [name for name in vars(kind) if not name.startswith("_")]
    return not isinstance(value, type) and all(hasattr(value, name) for name in methods)


_WORDS: Mapping[Any, tuple[str, str]] = {
    bool: ("True or False", "of True or False"),
    int: ("a whole number from 0 on", "of whole numbers from 0 on"),
    float: ("a finite number", "of finite numbers"),
    str: ("a text", "of texts"),
    type(None): ("None", "of None"),
}


def _in_words(kind: Any) -> str:
    """What a setting may be."""
    origin, of = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return _listed([_in_words(one) for one in of])
    if origin is Literal:
        return _listed([f'"{word}"' for word in of])
    if origin in (Sequence, tuple):
        many = "a list" if origin is Sequence or of[-1] is Ellipsis else f"a list of {len(of)}"
        return f"{many} {_WORDS[of[0]][1] if of[0] in _WORDS else 'of ' + _in_words(of[0])}"
    return _WORDS[kind][0] if kind in _WORDS else f"an object of type {kind.__name__}"


def _listed(words: Sequence[str]) -> str:
    """One or the other: "a, b or c"."""
    return " or ".join((", ".join(words[:-1]), words[-1])) if len(words) > 1 else words[0]
