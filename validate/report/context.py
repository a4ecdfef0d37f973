"""What the page is made from: comparisons, training data, and how the run came about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

from flysid.dataset import Dataset
from flysid.validate.compare import Comparison
from flysid.validate.diagnostics import Diagnosis, diagnose


@dataclass(frozen=True)
class Sweep:
    """Rule counts tried on training and validation data.

    Attributes
    ----------
    rules, error, spread : per count, the error (in the output's unit) and its standard error.
    chosen : the count taken.
    linear : error and spread of the linear model on the same data, or None.
    words : how the choice was made, one sentence.
    """

    rules: tuple[int, ...]
    error: tuple[float, ...]
    spread: tuple[float, ...]
    chosen: int
    linear: tuple[float, float] | None = None
    words: str = ""


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
    """

    comparisons: Mapping[str, Comparison]
    train: Mapping[str, Dataset] = field(default_factory=dict)
    sweeps: Mapping[str, Sweep] = field(default_factory=dict)
    command: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)
    remark: str = ""

    @cached_property
    def diagnoses(self) -> dict[str, Diagnosis]:
        """Tests of every channel on its held-out data; made once."""
        return {name: diagnose(c, self.train.get(name)) for name, c in self.comparisons.items()}

    @classmethod
    def of(cls, comparisons: Mapping[str, Comparison]) -> ReportContext:
        """A report of comparisons alone."""
        return cls(comparisons)
