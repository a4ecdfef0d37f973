"""What reading logs lost, in words on stderr."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from flysid.cli.output import REASONS_SHOWN, say
from flysid.showing import counted

if TYPE_CHECKING:
    from flysid.flight import Damage
    from flysid.ingest.lake.batch import Result


def report(results: Sequence[Result], quiet: bool) -> None:
    """Losses and skipped logs by name (even when quiet), then the sums."""
    for result in results:
        if result.damage.lossy:
            for line in losses(result.damage):
                say(f"lost: {result.path}: {line}")
        elif result.skipped:
            say(f"skipped: {result.path}: {result.reason}")
    new = [r.flight for r in results if r.flight and not r.unchanged]
    counts = [f"{counted(len(new), 'log')} ingested, {counted(sum(f.rows for f in new), 'record')}"]
    if unchanged := sum(r.unchanged for r in results):
        counts.append(f"{unchanged} unchanged")
    if skipped := sum(r.skipped for r in results):
        counts.append(f"{skipped} skipped")
    say(", ".join(counts), quiet)


def losses(damage: Damage, *, most_regions: int = 12) -> list[str]:
    """What was lost, one line per kind; bytes with their ranges."""
    lines = []
    if damage.bytes_skipped:
        places = ", ".join(f"{r.start}-{r.end} ({r.reason})" for r in damage.regions[:most_regions])
        more = damage.region_count - min(len(damage.regions), most_regions)
        tail = f" and {more:,} more" if more > 0 else ""
        lines.append(
            f"{counted(damage.bytes_skipped, 'byte')} skipped in {counted(damage.region_count, 'place')}: "
            f"{places}{tail}"
        )
    if damage.bad_checksums:
        lines.append(counted(damage.bad_checksums, "bad checksum"))
    if damage.truncated:
        lines.append("the file ends inside a record")
    for label, counts in (
        ("not decoded", damage.undecoded),
        ("with rejected times", damage.time_outliers),
    ):
        if counts:
            lines.append(f"{counted(sum(counts.values()), 'record')} {label}: " + _counts(dict(counts)))
    lines += [f"{stream}: {why}" for stream, why in list(damage.reasons.items())[:REASONS_SHOWN]]
    return lines


def _counts(counts: dict[str, int]) -> str:
    shown = sorted(counts.items(), key=lambda item: -item[1])[:8]
    rest = len(counts) - len(shown)
    return ", ".join(f"{name} {count:,}" for name, count in shown) + (f" and {rest} more" if rest else "")
