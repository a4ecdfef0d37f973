"""What a page may ask: queries and bodies, each checked as a whole before anything is done."""

from __future__ import annotations

from typing import Any, Literal

import msgspec


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

    Attributes
    ----------
    f : the flight's id.
    s : fields, each as "stream:field".
    t0, t1 : seconds since the flight's start; the whole flight without them.
    w : pixels across.
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
