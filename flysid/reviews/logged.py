"""A log under review, with the rate loops that its gains define."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from flysid.ingest.lake.clocked import BoolArray as BoolArray
from flysid.ingest.lake.clocked import ClockedLog
from flysid.ingest.lake.clocked import Column as Column

if TYPE_CHECKING:
    from flysid.ingest.align.recipe import Recipe
    from flysid.loops.judged import Judged


@dataclass(frozen=True, eq=False)
class LoggedFlight(ClockedLog):
    """A log under review.

    Attributes
    ----------
    recipe : where a log whose format names nothing, such as a table, holds what: its channels are loops
        where they carry a loop's name (roll, roll_rate, v_north, height), its signals roll_rate, pitch_rate
        and yaw_rate are the gyro.
    """

    recipe: Recipe | None = None

    @cached_property
    def judged(self) -> tuple[Judged, ...]:
        """The rate loops of roll and pitch and their margins; () of a log whose gains are not read.

        What is resampled of them is not kept, and one axis is done before the next: it is large, and soon
        made again.
        """
        from flysid.loops.judged import judge, states_gains

        if getattr(self.log, "facts", None) is None or not states_gains(self.log):
            return ()
        return tuple(
            replace(found, loop=replace(found.loop)) if found.loop is not None else found
            for axis in ("roll", "pitch")
            for found in judge([self.log], [axis])
        )
