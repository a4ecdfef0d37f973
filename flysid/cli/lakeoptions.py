"""Options of verbs that work on many logs in object stores."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import click

from flysid.cli.bounds import COUNT
from flysid.cli.options import gather
from flysid.cli.output import say
from flysid.cli.trust import Own, Setting
from flysid.errors import UsageError
from flysid.showing import counted

if TYPE_CHECKING:
    from flysid.fleet.cluster import Cluster

LOOPBACK = re.compile(r"tcp://(127\.|localhost|\[::1\])")
_UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}


@dataclass(frozen=True)
class LakeOptions:
    """What the command line says of an ingest that an object store is part of."""

    cluster: str = ""
    workers: int = 0
    batch: int = 32
    since: datetime | None = None
    watch_s: float | None = None
    retry: bool = False

    def __post_init__(self) -> None:
        check_one_cluster(self.cluster, self.workers)

    def concerns(self, logs: Sequence[str], data: str) -> bool:
        """Whether an object store is part of it; raises UsageError where these options want one."""
        from flysid.place import is_address

        if is_address(data) or any(is_address(log) for log in logs):
            return True
        if self != LakeOptions():
            raise UsageError(
                "--cluster, --workers, --batch, --since, --watch and --retry are for addresses",
                hint="s3://BUCKET/FOLDER; on this machine -j says how many workers there are",
            )
        return False


@contextmanager
def dask_cluster(address: str, workers: int, quiet: bool) -> Iterator[Cluster]:
    """The cluster that --cluster or --workers asks for; says how many workers it has."""
    from flysid.fleet.cluster import connect

    with connect(address, workers) as cluster:
        if address.startswith("tcp://") and not LOOPBACK.match(address):
            say("this scheduler runs any code for whoever reaches it; tls:// with certificates is safer")
        say(f"cluster of {counted(cluster.workers, 'worker')}; dashboard: {cluster.dashboard}", quiet)
        yield cluster


def check_one_cluster(address: str, workers: int) -> None:
    """Raise UsageError where two clusters are requested."""
    if address and workers:
        raise UsageError("--workers makes a cluster, --cluster names one", hint="leave out one of them")


def check_pattern(pattern: str) -> None:
    """Raise UsageError where a text is no regular expression."""
    try:
        re.compile(pattern)
    except re.error as error:
        raise UsageError(
            f"--vehicle-in is not a valid regular expression: {error}", hint="v[0-9]+"
        ) from error


def seconds(_ctx: click.Context, _param: click.Parameter, text: str | None) -> float | None:
    if not text:
        return None
    found = re.fullmatch(r"(\d+(?:\.\d+)?)([smhd]?)", text)
    if found is None:
        raise click.BadParameter("e.g. 30s, 5m, 1h")
    return float(found[1]) * _UNITS[found[2] or "s"]


def _moment(_ctx: click.Context, _param: click.Parameter, text: str | None) -> datetime | None:
    if not text:
        return None
    try:
        when = datetime.fromisoformat(text)
    except ValueError as error:
        raise click.BadParameter("e.g. 2026-10-01 or 2026-10-01T12:00") from error
    return when if when.tzinfo else when.replace(tzinfo=UTC)


CLUSTER = (
    click.option(
        "--cluster",
        cls=Own,
        default="",
        metavar="ADDRESS",
        help="A Dask scheduler, e.g. tcp://10.0.0.1:8786; it runs code for anyone who can connect.",
    ),
    click.option(
        "--workers",
        cls=Own,
        default=0,
        type=COUNT,
        metavar="N",
        help="A Dask cluster of N processes on this machine.",
    ),
)


lake_options = gather(
    "lake",
    LakeOptions,
    *CLUSTER,
    click.option(
        "--batch",
        default=32,
        show_default=True,
        type=click.IntRange(1, 1024),
        help="Largest number of logs per task.",
    ),
    click.option(
        "--since",
        cls=Setting,
        default=None,
        metavar="DATE",
        callback=_moment,
        help="From an address: only logs that arrived then or later (UTC).",
    ),
    click.option(
        "--watch",
        "watch_s",
        cls=Own,
        default=None,
        metavar="TIME",
        callback=seconds,
        help="From an address: look again at this interval, e.g. 5m, until interrupted.",
    ),
    click.option("--retry", cls=Own, is_flag=True, help="From an address: logs in quarantine, too."),
)
"""--cluster, --workers, --batch, --since, --watch and --retry; the verb takes them as one `lake`."""
