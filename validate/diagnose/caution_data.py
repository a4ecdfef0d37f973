"""Cautions about the data that models were fitted to, whatever the models make of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from flysid.escaping import one_line
from flysid.ingest.align.doubts import REMARKS, Doubt
from flysid.validate.diagnose.caution import Caution, join

WEIGHTS: Mapping[str, float] = {
    "quiet": 9.0,
    "slow": 6.0,
    "short": 5.5,
    "narrow": 4.5,
    "holes": 4.2,
    "kinematics": 4.0,
    "pooled": 3.5,
    "band": 0.4,
}
"""Coherence is left out: it is judged on the held-out part, by a rule of its own."""


def in_the_data(doubts: Mapping[str, Sequence[Doubt]]) -> Iterator[Caution]:
    """What alignment said of the data, by channel; the same of several channels is said once."""
    said: dict[tuple[str, str, str], list[str]] = {}
    for channel, own in doubts.items():
        for d in own:
            if d.kind == "band":  # another one for every channel: listed
                said.setdefault((d.kind, "", d.todo), []).append(d.text)
            else:
                said.setdefault((d.kind, d.text, d.todo), []).append(channel)
    for (kind, text, todo), whom in said.items():
        if kind in WEIGHTS:
            words = f"{join(whom)}: {text}." if text else f"{join(whom)}."
            level = "note" if kind in REMARKS else "warning"
            yield Caution(level, one_line(words), f"{todo}." if todo else "", WEIGHTS[kind])
