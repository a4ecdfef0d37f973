"""A comparison that can show itself: as text, JSON, an HTML table in a notebook, a report.

What a comparison is (`comparison`) knows nothing of how it is shown; this is what `compare` hands to people.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from flysid.showing import first_lines
from flysid.validate.compare.comparison import Comparison


@dataclass(frozen=True, repr=False)
class ShownComparison(Comparison):
    """A comparison of one channel that renders itself."""

    @classmethod
    def of(cls, comparison: Comparison) -> ShownComparison:
        """The same comparison, with all that it holds."""
        return cls(**{f.name: getattr(comparison, f.name) for f in fields(comparison)})

    def to_json(self) -> dict[str, Any]:
        """The JSON document of this comparison alone."""
        from flysid.validate.diagnose.document import to_json

        return to_json(self._alone)

    def report(self, path: str | Path) -> Path:
        """Write the HTML report of this comparison alone; returns the path."""
        from flysid.validate.show.page import ReportContext, write_report

        return write_report(path, ReportContext.of(self._alone))

    @property
    def _alone(self) -> dict[str, Comparison]:
        return {self.channel or "channel": self}

    def _repr_html_(self) -> str:
        from flysid.validate.show.tables import to_html

        return str(to_html(self._alone))

    def __repr__(self) -> str:
        return first_lines(str(self))

    def plot(self, output: str | None = None, ax: Any = None) -> Any:
        """The longest held-out segment, measured and in free run of both models, as matplotlib axes.

        Parameters
        ----------
        output : its name; the first where None.
        ax : axes to draw into; new ones where None.

        Raises
        ------
        UsageError : matplotlib is not installed; no such output.
        """
        from flysid.validate.show.paperfigures import plot_free_run

        return plot_free_run(self, output, ax)

    def __str__(self) -> str:
        from flysid.validate.show.terminal import table

        return table(self._alone)
