"""What a log lacks, in the file and before it was written: one count, and the same words in every verb."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flysid.facts.link import LinkLoss
from flysid.flight import Damage
from flysid.showing import counted

MOST_REGIONS = 12  # of a file, in a list of losses
MOST_STREAMS = 8
MOST_REASONS = 3


def lost_words(damage: Damage) -> str:
    """Losses in a few words: in the file, then before it was written; "" where there are none.

    >>> lost_words(Damage(bad_checksums=2, sequence_gaps={"1.1": 40}, silence_gaps={"1.1": 512}))
    '2 bad checksums, 40 on the link and likely 512 more in silences'
    """
    parts = []
    if damage.bytes_skipped:
        parts.append(f"{counted(damage.bytes_skipped, 'byte')} in {counted(damage.region_count, 'place')}")
    if damage.truncated:
        parts.append("end cut off")
    undecoded = sum(damage.undecoded.values())
    outliers = sum(damage.time_outliers.values())
    for count, words in (
        (damage.bad_checksums, counted(damage.bad_checksums, "bad checksum")),
        (undecoded, f"{undecoded:,} not decoded"),
        (outliers, counted(outliers, "rejected time")),
    ):
        if count:
            parts.append(words)
    on_the_link = sum(damage.sequence_gaps.values())
    if on_the_link:
        parts.append(f"{on_the_link:,} on the link{_in_silences(sum(damage.silence_gaps.values()))}")
    return ", ".join([*parts, *_dropped(damage)])


def loss_lines(damage: Damage) -> list[str]:
    """What was lost, one line per kind; bytes with their ranges, messages with their senders."""
    lines = []
    if damage.bytes_skipped:
        shown = damage.regions[:MOST_REGIONS]
        places = ", ".join(f"{r.start}-{r.end} ({r.reason})" for r in shown)
        more = damage.region_count - len(shown)
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
            lines.append(f"{counted(sum(counts.values()), 'record')} {label}: " + _listed(counts))
    lines += [f"{stream}: {why}" for stream, why in list(damage.reasons.items())[:MOST_REASONS]]
    lines += [
        f"{counted(count, 'message')} of {name} never arrived{_in_silences(damage.silence_gaps.get(name, 0))}"
        for name, count in sorted(damage.sequence_gaps.items())
    ]
    return [*lines, *_dropped(damage)]


def repeat_lines(damage: Damage) -> list[str]:
    """What came more than once and is kept once, one line per sender.

    >>> repeat_lines(Damage(repeats={"1.1": 4096}))[0].partition(" (")[0]
    '4,096 messages of 1.1 came again, byte for byte'
    """
    return [
        f"{counted(count, 'message')} of {name} came again, byte for byte (a loop of routers, or two ways "
        "here): one of each is kept"
        for name, count in sorted(damage.repeats.items())
    ]


def lines_of_flights(lost: Mapping[str, str], most: int) -> list[str]:
    """What flights lack, one line each; beyond `most` of them one line that counts the rest.

    `lost`: flight -> what its log lacks, in words; "" where nothing is known to be lost.

    >>> lines_of_flights({"a": "end cut off", "b": "", "c": "2 bad checksums", "d": "end cut off"}, 2)
    ['a: end cut off', 'c: 2 bad checksums', '1 more flight lacks something']
    """
    lines = [f"{name}: {words}" for name, words in lost.items() if words]
    rest = len(lines) - most
    if rest <= 0:
        return lines
    return [*lines[:most], f"{counted(rest, 'more flight')} {'lacks' if rest == 1 else 'lack'} something"]


def link_words(loss: LinkLoss) -> str:
    """What a link lost of one sender, and what came again.

    >>> link_words(LinkLoss(frames=90, lost=10, repeated=1))
    'lost by the link: 10 %; 1 came again, byte for byte'
    """
    share = f"{100 * loss.share:.2g} %" if loss.missing else "none"
    again = f"; {loss.repeated:,} came again, byte for byte" if loss.repeated else ""
    return f"lost by the link: {share}{again}"


def _in_silences(hidden: int) -> str:
    return f" and likely {hidden:,} more in silences" if hidden else ""


def _dropped(damage: Damage) -> Sequence[str]:
    """What the recorder itself counted as lost."""
    return [
        f"{count:,} ms dropped" if kind == "ms" else f"{counted(count, kind.removesuffix('s'))} dropped"
        for kind, count in sorted(damage.dropouts.items(), key=lambda item: item[0] == "ms")
        if count
    ]


def _listed(counts: Mapping[str, int]) -> str:
    shown = sorted(counts.items(), key=lambda item: -item[1])[:MOST_STREAMS]
    rest = len(counts) - len(shown)
    return ", ".join(f"{name} {count:,}" for name, count in shown) + (f" and {rest} more" if rest else "")
