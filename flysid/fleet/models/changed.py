"""Which vehicles of a fleet no longer fly as they did, or not as the others: from triangles to a document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from flysid.catalogue import FlightFacts
from flysid.errors import DataError
from flysid.facts.vehicle import vehicle_of
from flysid.fleet.models.common_grid import Sampling
from flysid.fleet.models.differences import FlightPart, JudgedChannel, Test, judge, judge_channel
from flysid.fleet.models.flag_words import Flag, Smallest, finding, short_names, sizes, smallest
from flysid.fleet.models.gather import Gathered
from flysid.ingest.align.recipe import Recipe
from flysid.model.threads import on_one_thread
from flysid.version import __version__

FORMAT = "flysid-fleet-changed"
FORMAT_VERSION = 1


@dataclass(frozen=True, eq=False)
class FleetComparison:
    """A fleet, compared.

    `recipe`: by which.
    `rate`: of false discoveries.
    `before_ns`: flights that began before (UTC, ns) are early; None: the first half of each vehicle's.
    `channels`: that were compared.
    `findings`: what was flagged, the surest first.
    `smallest`: by channel, what would have been flagged.
    `skipped`: channels that were not compared, and why.
    `flights`: of the fleet.
    """

    recipe: Recipe
    rate: float
    before_ns: int | None
    channels: tuple[JudgedChannel, ...]
    findings: tuple[Flag, ...]
    smallest: Mapping[str, Smallest]
    skipped: Mapping[str, str]
    flights: tuple[FlightFacts, ...]

    @cached_property
    def names(self) -> dict[str, str]:
        """All vehicles, and what they are called here."""
        return short_names({vehicle_of(facts.info) for facts in self.flights})

    def document(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "flysid": __version__,
            "recipe": self.recipe.name,
            "false_discovery_rate": self.rate,
            "before_ns": self.before_ns,
            "vehicles": self.names,
            "flights": len(self.flights),
            "findings": [asdict(found) for found in self.findings],
            "channels": {j.channel: self._channel(j) for j in self.channels},
            "skipped": dict(self.skipped),
        }

    def _channel(self, judged: JudgedChannel) -> dict[str, Any]:
        spec = self.recipe.channel(judged.channel)
        least = self.smallest.get(judged.channel)
        omega = judged.band.frequencies
        return {
            "input": judged.sampling.inputs[0],
            "output": judged.sampling.outputs[0],
            "dt_s": judged.sampling.dt_s,
            "lags": judged.sampling.lags,
            "frequencies_hz": (omega / (2.0 * np.pi)).tolist(),
            "shows": spec.shows,
            "hides": spec.hides,
            "smallest": asdict(least) if least else None,
            "too_few": dict(judged.too_few),
            "common": None if judged.common is None else judged.common.tolist(),
            "tests": [_test(t, omega) for t in judged.tests],
        }


def _test(test: Test, omega: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, Any]:
    gain, delay = sizes(test, omega)
    return {
        "vehicle": test.vehicle,
        "question": test.question,
        "flights": test.flights,
        "t2": test.statistic,
        "p": test.p,
        "flagged": test.flagged,
        "gain": asdict(gain),
        "delay": asdict(delay),
    }


@on_one_thread
def compare_parts(
    recipe: Recipe,
    samplings: Mapping[str, Sampling],
    parts: Mapping[str, Sequence[FlightPart]],
    rate: float,
    before_ns: int | None = None,
) -> tuple[list[JudgedChannel], dict[str, str]]:
    """Every channel's tests, flagged; and the channels that could not be compared, and why."""
    found: list[JudgedChannel] = []
    skipped: dict[str, str] = {}
    for channel in parts:
        try:
            found.append(judge_channel(channel, parts[channel], samplings[channel], before_ns))
        except DataError as error:
            skipped[channel] = error.message
    return judge(found, rate), {c: why for c, why in skipped.items() if c in recipe.channels}


def compare(
    gathered: Gathered,
    recipe: Recipe,
    flights: Sequence[FlightFacts],
    rate: float = 0.05,
    before_ns: int | None = None,
) -> FleetComparison:
    """Compare a fleet's vehicles with themselves and with each other.

    Parameters
    ----------
    gathered : what `gather` keeps of the fleet.
    flights : of the fleet.
    rate : of false ones among the flagged, at most.
    before_ns : see `FleetComparison`.

    Raises
    ------
    DataError : no channel can be compared.
    """
    channels, skipped = compare_parts(recipe, gathered.samplings, gathered.parts, rate, before_ns)
    skipped = {**gathered.skipped, **skipped}
    if not channels:
        raise DataError(
            f"no channel of recipe {recipe.name!r} can be compared: "
            + "; ".join(f"{name}: {why}" for name, why in skipped.items()),
            hint="another recipe, or more flights of each vehicle",
        )
    starts = {facts.id: facts.start_utc_ns for facts in flights}
    tests = sum(len(j.tests) for j in channels)
    flags = sorted(((t, j) for j in channels for t in j.tests if t.flagged), key=lambda flag: flag[0].p)
    names = short_names({vehicle_of(facts.info) for facts in flights})
    return FleetComparison(
        recipe=recipe,
        rate=rate,
        before_ns=before_ns,
        channels=tuple(channels),
        findings=tuple(finding(t, j, recipe, starts, names[t.vehicle]) for t, j in flags),
        smallest={j.channel: s for j in channels if (s := smallest(j, tests, rate)) is not None},
        skipped=skipped,
        flights=tuple(flights),
    )
