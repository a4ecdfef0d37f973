"""A caution in words, and what every rule that makes one needs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from flysid.escaping import one_line
from flysid.validate.compare.comparison import Comparison
from flysid.validate.diagnose.diagnostics import Diagnosis


@dataclass(frozen=True)
class Caution:
    """One caution. `level` is "danger", "warning", "note" or "good"; `weight` orders within a level."""

    level: str
    text: str
    todo: str
    weight: float = 0.0


Comparisons = Mapping[str, Comparison]
Diagnoses = Mapping[str, Diagnosis]


def join(parts: Iterable[str]) -> str:
    """The parts on one line, each once."""
    return one_line(", ".join(dict.fromkeys(parts)))


def heads(comparison: Comparison) -> Iterator[str]:
    """The two models of the headline."""
    yield comparison.baseline
    if comparison.contender:
        yield comparison.contender
