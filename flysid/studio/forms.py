"""What a page may ask: queries and bodies, each checked as a whole before anything is done."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar

import msgspec
from starlette.requests import Request

from flysid.errors import UsageError

Form = TypeVar("Form")


class Listing(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Words that a flight's facts must hold, and how many flights to list."""

    q: str = ""
    most: int = 500


class Nothing(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """No query at all."""


class Filters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Filters to try and to take away, as `flysid filters` takes them."""

    more: tuple[str, ...] = ()
    without: tuple[str, ...] = ()


class Window(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a page asks to see.

    `f`: the flight's id.
    `s`: fields, each as "stream:field".
    `t0`, `t1`: seconds since the flight's start; the whole flight without them.
    `w`: pixels across.
    """

    f: str
    s: tuple[str, ...] = msgspec.field(default=())
    t0: float | None = None
    t1: float | None = None
    w: int = 1200


class Aligned(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One channel of one flight by one recipe; `x` are the parts of flights that are left out."""

    f: str
    r: str
    ch: str
    x: tuple[str, ...] = ()


class Explained(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A held-out segment of a channel, and one of its rows to explain in words."""

    ch: str
    segment: int = 0
    row: int | None = None


class Upload(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A log that is dropped: its name, and what its bytes do not tell."""

    name: str
    format: str = ""
    time_unit: str = ""
    date_order: str = ""


class Draft(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A recipe, as TOML or as the values of a form."""

    toml: str | None = None
    form: dict[str, Any] | None = None


class Fit(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The settings of a fit, named as the command's options; empty ones are left to the command.

    `inputs` and `outputs` are STREAM.FIELD and take the place of a recipe. `modes_flown` are flight modes.
    `name` is the run's.
    """

    recipe: str = ""
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    flights: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    between: str = ""
    modes_flown: tuple[str, ...] = ()
    keep_mishaps: bool = False
    models: str = ""
    rules: str = ""
    effort: str = ""
    holdout: tuple[str, ...] = ()
    by: str = ""
    seed: int | None = None
    name: str = ""
    preview: bool = False


class Validate(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The run to judge; `figures` is the type of file in which they are drawn, too."""

    run: str
    figures: Literal["", "pdf", "svg", "png"] = ""
    preview: bool = False


class Compare(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Two runs."""

    a: str
    b: str
    preview: bool = False


def query_of(request: Request, form: type[Form]) -> Form:
    """The query as a form; raises UsageError that names what is wrong. Repeated names become tuples."""
    known = {f.name: f for f in msgspec.structs.fields(form)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for name in request.query_params:
        given = request.query_params.getlist(name)
        is_many = name in known and isinstance(known[name].default, tuple)
        if len(given) > 1 and not is_many:
            raise UsageError(f"{name} is given {len(given)} times")
        values[name] = tuple(given) if is_many else given[0]
    return _convert(lambda: msgspec.convert(values, form, strict=False))


async def body_of(request: Request, form: type[Form]) -> Form:
    """The body, JSON, as a form; raises UsageError that names what is wrong."""
    body = await request.body()
    return _convert(lambda: msgspec.json.decode(body, type=form))


def _convert(convert: Callable[[], Form]) -> Form:
    try:
        return convert()
    except (msgspec.ValidationError, msgspec.DecodeError, RecursionError) as error:
        raise UsageError(f"not understood: {error}") from error
