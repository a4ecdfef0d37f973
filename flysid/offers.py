"""What installed packages add to flysid: rows of its tables, named by entry points.

| group | names |
|---|---|
| `flysid.structures` | a `flysid.model.structures.Structure` |
| `flysid.formats` | a `flysid.ingest.formats.base.Format` |
| `flysid.verbs` | a `flysid.cli.verbs.Verb` |
| `flysid.recipes` | the module beside which the file NAME.toml lies |
| `flysid.figures` | a `flysid.validate.show.page.modelpanels.Figure` |

Packages are looked for where Python imports from, except in folders that are named relative to the working
folder: that one may be a stranger's.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

from flysid.errors import UsageError

MARK = b"[flysid."
SUFFIXES = (".dist-info", ".egg-info")
T = TypeVar("T")


@dataclass(frozen=True)
class Offer:
    """One entry point of a group of flysid's.

    Attributes
    ----------
    group, name, value : as the package states them.
    package : that states them.
    """

    group: str
    name: str
    value: str
    package: str

    def load(self) -> Any:
        """What it names. Raises UsageError where that cannot be imported."""
        try:
            return import_name(self.value)
        except Exception as error:
            raise self.refusal(f"it cannot be imported ({type(error).__name__}: {error})") from error

    def refusal(self, why: str) -> UsageError:
        """The error that explains why it is of no use."""
        kind = self.group.removeprefix("flysid.").removesuffix("s")
        return UsageError(
            f"the entry point {self.name!r} of {self.group} is not a new {kind}: {why}",
            hint=f"it comes with the package {self.package}: upgrade that, or pip uninstall {self.package}",
        )


def import_name(path: str) -> Any:
    """What stands at "module" or "module:name", where a name may have dots.

    Examples
    --------
    >>> from flysid.offers import import_name
    >>> import_name("math:pi") > 3
    True
    """
    module, _, name = path.partition(":")
    found: Any = importlib.import_module(module.strip())
    for part in filter(None, name.strip().split(".")):
        found = getattr(found, part)
    return found


def offers(group: str) -> tuple[Offer, ...]:
    """The entry points of a group, by name.

    Examples
    --------
    >>> from flysid.offers import offers
    >>> offers("flysid.nothing")
    ()
    """
    paths = tuple(path for path in sys.path if os.path.isabs(path))
    return tuple(offer for offer in _offers(paths) if offer.group == group)


def rows(group: str, kind: type[T]) -> Iterator[tuple[Offer, T]]:
    """The rows that a group's entry points name. Raises UsageError where one is not of this kind."""
    for offer in offers(group):
        row = offer.load()
        if not isinstance(row, kind):
            raise offer.refusal(f"it must name a {kind.__module__}.{kind.__qualname__}")
        yield offer, row


@cache
def _offers(paths: tuple[str, ...]) -> tuple[Offer, ...]:
    """Every entry point of flysid's groups; `importlib.metadata` is slow: it is left out where none is."""
    if not any(map(_may_offer, paths)):
        return ()
    from importlib.metadata import distributions

    found: dict[str, list[Offer]] = {}
    for package in distributions(path=list(paths)):
        name = package.name
        if name not in found:  # as for imports, the first on the path counts
            found[name] = [Offer(e.group, e.name, e.value, name) for e in package.entry_points]
    every = (offer for some in found.values() for offer in some if offer.group.startswith("flysid."))
    return tuple(sorted(every, key=lambda offer: (offer.group, offer.name)))


def _may_offer(path: str) -> bool:
    """Whether a package below a path has entry points of flysid's; an archive may."""
    try:
        with os.scandir(path) as entries:
            named = [entry.path for entry in entries if entry.name.endswith(SUFFIXES)]
    except NotADirectoryError:
        return True
    except OSError:
        return False
    return any(map(_mentions_flysid, named))


def _mentions_flysid(folder: str) -> bool:
    try:
        with open(os.path.join(folder, "entry_points.txt"), "rb") as stream:
            return MARK in stream.read()
    except OSError:
        return False
