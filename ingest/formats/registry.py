"""Every log format that flysid reads, and how a log's format is found.

A folder beside this module is a format where its package holds rows: `FORMATS`, a tuple of `Format`. Another
package adds one with an entry point of the group "flysid.formats" that names a `Format`.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path, PurePosixPath

from flysid.errors import FormatError, UsageError
from flysid.flight import Flight
from flysid.ingest.formats.base import WHOLE_BATCH_BYTES, Format, Limits, collect
from flysid.ingest.formats.blame import blaming
from flysid.ingest.formats.common.packed_names import own_name
from flysid.ingest.formats.opening import OpenLog, members_of, open_log
from flysid.ingest.formats.recognised import stranger
from flysid.ingest.formats.refusals import refuse
from flysid.ingest.formats.rosbag2.side_files import names_beside
from flysid.mirror import log_at
from flysid.offers import rows
from flysid.place import Place, is_address
from flysid.showing import one_of

ENTRY_POINTS = "flysid.formats"
CERTAIN = 0.95
PLAUSIBLE = 0.3


def _own_formats() -> dict[str, Format]:
    """The rows `FORMATS` of the folders beside this module, by name."""
    beside = pkgutil.iter_modules([str(Path(__file__).parent)])
    packages = [importlib.import_module(f"{__package__}.{info.name}") for info in beside if info.ispkg]
    rows = [row for package in packages for row in getattr(package, "FORMATS", ())]
    return {row.name: row for row in sorted(rows, key=lambda row: row.name)}


FORMATS: Mapping[str, Format] = _own_formats()
"""flysid's own formats, by name."""


@cache
def all_formats() -> Mapping[str, Format]:
    """Every format by name: flysid's own, then those of installed packages.

    Raises
    ------
    UsageError : an installed package offers something that is no format, or a name that is taken.
    """
    found = dict(FORMATS)
    for offer, row in rows(ENTRY_POINTS, Format):
        if row.name in found:
            raise offer.refusal(f"the name {row.name!r} is taken")
        found[row.name] = row
    return found


def find_format(name: str) -> Format:
    """The format of this name. Raises UsageError where there is none."""
    try:
        return all_formats()[name]
    except KeyError:
        raise UsageError(f"no format {name!r}", hint=one_of(list(all_formats()), name)) from None


def detect(head: bytes, name: str) -> Format:
    """The format of a file by its first bytes; its name only breaks ties.

    Raises FormatError when no format recognises it, or when it is known to be something else.
    """
    if not head:
        raise FormatError(
            "the file is empty", path=name, byte=0, hint="check that the download or copy finished"
        )
    if (kind := stranger(head)) is not None:
        raise FormatError(f"this is {kind.title}, not a log", path=name, byte=0, hint=kind.hint)
    lower = name.lower()
    for likely in FORMATS.values():
        if lower.endswith(likely.suffixes) and likely.sniff(head, name) >= CERTAIN:
            return likely  # the usual case: no other reader is imported
    confidence, best = _most_likely(head, name)
    if confidence < PLAUSIBLE:
        raise refusal_of(head, name)
    return best


def refusal_of(head: bytes, name: str) -> FormatError:
    """The error of a file that no format recognises: what is wrong with it, and what to do."""
    return refuse(head, name, list(all_formats().values()), lambda other: _most_likely(other, name))


def format_of(log: OpenLog, limits: Limits) -> Format:
    """The format that the caller names, or the one that the log's first bytes tell."""
    if limits.format:
        return find_format(limits.format)
    if not log.head:
        raise FormatError(
            "nothing but zeros",
            path=log.name,
            byte=0,
            hint="copy it from the vehicle again; if it is zeros there, too, it was never written",
        )
    return detect(log.head, log.name)


def confidence_of(head: bytes, name: str) -> float:
    """How sure the format is that is most likely of a file; see `Format.sniff`."""
    return _most_likely(head, name)[0]


def _most_likely(head: bytes, name: str) -> tuple[float, Format]:
    """Confidence and format; of a head that no format knows, behind the zeros that it begins with."""
    lower = name.lower()
    scored = [
        (f.sniff(head, name) + (0.05 if lower.endswith(f.suffixes) else 0.0), f)
        for f in all_formats().values()
    ]
    best = max(scored, key=lambda pair: pair[0])
    rest = head.lstrip(b"\0")
    return _most_likely(rest, name) if best[0] < PLAUSIBLE and 0 < len(rest) < len(head) else best


def read(
    path: str | Path,
    *,
    format: str | None = None,  # noqa: A002
    time_unit: str = "",
    date_order: str = "",
    limits: Limits | None = None,
) -> Flight:
    """Read a whole log into memory.

    Parameters
    ----------
    path : the log, or its address in an object store (`s3://`, `gs://`, `az://`); also packed (.gz, .zst),
        or in a .zip archive: `flights.zip/one.tlog`, or the archive itself where it holds one log.
    format : name of its format; found from its bytes when None.
    time_unit : of a table's times that state none: "s", "ms", "us", "ns", "min", "h" or "d".
    date_order : of a table's dates that may be meant in two: "dmy", "mdy" or "ymd".
    limits : bounds for hostile input.

    Raises
    ------
    FormatError : not a log, empty or unreadable; a table whose times may be in several units or orders.
    UsageError : `format`, `time_unit` or `date_order` is no name that flysid knows; no log is at the address.

    Examples
    --------
    >>> flight = flysid.read("sample_logs/01-steps-seed2.tlog")
    >>> "ATTITUDE" in flight
    True
    """
    limits = limits or Limits(batch_bytes=WHOLE_BATCH_BYTES)
    limits = replace(
        limits,
        time_unit=time_unit or limits.time_unit,
        date_order=date_order or limits.date_order,
        format=format or limits.format,
    )
    file = _file(path)
    with blaming(file), open_log(sole_log(file), limits) as log:
        fmt = format_of(log, limits)
        return log.told(collect(log.view, log.name, fmt, limits, log.rest_for(fmt)))


def _file(path: str | Path) -> Path:
    """`path`, or a copy of the log that is at this address."""
    if not is_address(path):
        return Path(path)
    found = log_at(Place(str(path)), names_beside)
    if found is None:
        raise UsageError(
            "no log is there", path=path, hint=f"for a folder of logs: flysid ingest {path} -o DATA"
        )
    return found


def known_suffixes() -> tuple[str, ...]:
    """How the names of logs end, in lower case."""
    return tuple({suffix for fmt in all_formats().values() for suffix in fmt.suffixes})


def sole_log(path: Path) -> Path:
    """`path`, or, for a .zip archive, its only member that is called like a log; hidden files are none.

    Where that says nothing, `path` comes back: opening it names the members.
    """
    seen = [name for name in members_of(path) if not PurePosixPath(name).name.startswith(".")]
    named = [name for name in seen if own_name(name).lower().endswith(known_suffixes())]
    return path / named[0] if len(named) == 1 else path
