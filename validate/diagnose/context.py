"""What the page is made from: comparisons, training data, and how the run came about."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from flysid.catalogue import FlightFacts
from flysid.dataset import Dataset
from flysid.extras import Missing
from flysid.ingest.align.doubts import Doubt
from flysid.loops.judged import Judged
from flysid.progress import tell
from flysid.validate.compare.comparison import Comparison
from flysid.validate.diagnose.diagnostics import Diagnosis, diagnose

_NUMBER = r"\d+(?:\.\d+)?(?:e[+-]?\d+)?"
_TRIED = rf"\d+: {_NUMBER}(?: \+- {_NUMBER})?"


@dataclass(frozen=True)
class Sweep:
    """Rule counts tried on training and validation data.

    Attributes
    ----------
    rules, error, spread : per count, the error and its standard error (0 where not known, and of what the
        others are compared with).
    chosen : the count taken.
    linear : error and spread of the linear model on the same data, or None.
    words : how the choice was made, one sentence.
    unit : of the error; the output's when None.
    """

    rules: tuple[int, ...]
    error: tuple[float, ...]
    spread: tuple[float, ...]
    chosen: int
    linear: tuple[float, float] | None = None
    words: str = ""
    unit: str | None = None

    @classmethod
    def from_notes(cls, notes: Sequence[str], chosen: int) -> Sweep | None:
        """The sweep that TS tells of in its notes, or None.

        It reads "... by number of rules, in UNIT: 1: 0.13 +- 0.01, 2: 0.15, ..."; the next note says why.
        Notes are what a saved model keeps of how it was chosen.
        """
        for i, note in enumerate(notes):
            match = re.search(rf"by number of rules, in ([^:]+): ({_TRIED}(?:, {_TRIED})*)", note)
            if match is None:
                continue
            tried = re.findall(rf"(\d+): ({_NUMBER})(?: \+- ({_NUMBER}))?", match[2])
            if len(tried) < 2:
                return None
            words = notes[i + 1] if i + 1 < len(notes) else ""
            return cls(
                tuple(int(rules) for rules, _, _ in tried),
                tuple(float(error) for _, error, _ in tried),
                tuple(float(spread or 0.0) for _, _, spread in tried),
                chosen,
                words=words,
                unit=match[1],
            )
        return None


@dataclass(frozen=True)
class ReportContext:
    """One report.

    Attributes
    ----------
    comparisons : by channel name; corrected over channels (`across_channels`).
    train : training data by channel name, where known: coverage and extrapolation need it.
    sweeps : rule-count sweeps by channel name, where made.
    command : the command line that makes this page again.
    provenance : label -> value: data hash, split, seeds, versions; shown under Reproduce.
    remark : a short remark above the title, such as "simulated flights".
    fit_seconds : wall time of every fit, by channel and model, where known.
    doubts : reasons in the training data not to trust any model, by channel name.
    skipped : channels that are not on the page, with the reason.
    flights : what the catalogue knows of the run's flights.
    loops : what the gains that the flights' logs state mean; empty where none is known.
    missing : what could not be given beside the comparison, as far as it was tried.
    """

    comparisons: Mapping[str, Comparison]
    train: Mapping[str, Dataset] = field(default_factory=dict)
    sweeps: Mapping[str, Sweep] = field(default_factory=dict)
    command: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)
    remark: str = ""
    fit_seconds: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    doubts: Mapping[str, Sequence[Doubt]] = field(default_factory=dict)
    skipped: Mapping[str, str] = field(default_factory=dict)
    flights: Sequence[FlightFacts] = ()
    loops: Sequence[Judged] = ()
    missing: Missing = field(default_factory=Missing)

    @cached_property
    def diagnoses(self) -> dict[str, Diagnosis]:
        """Tests of every channel on its held-out data; made once."""
        found = {}
        with self.missing.gathering():
            for i, (name, c) in enumerate(self.comparisons.items()):
                tell("testing residuals and responses", channel=name, share=i / (len(self.comparisons) + 1))
                found[name] = diagnose(c, self.train.get(name))
        return found

    @classmethod
    def of(cls, comparisons: Mapping[str, Comparison]) -> ReportContext:
        """A report of comparisons alone."""
        return cls(comparisons)
