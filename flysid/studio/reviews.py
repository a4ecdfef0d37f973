"""The review of a flight as the page asks for it: sentences and figures that lead to plots; and its page."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from flysid.flight import split_address
from flysid.ingest.align.values import base_column
from flysid.ingest.lake.lake import StoredLog
from flysid.manifest import FLIGHTS, MANIFEST_FILE
from flysid.reviews.logged import LoggedFlight
from flysid.reviews.page import render
from flysid.reviews.review import review_flight
from flysid.reviews.reviewed import Review
from flysid.studio.flights import lake_of
from flysid.studio.folders import Workspace

KEPT = 16  # reviews of the flights that were looked at last


class Reviews:
    """Reviews of a studio's flights; each is computed once, and again when the flight was ingested anew."""

    def __init__(self, workspace: Workspace) -> None:
        self._data = workspace.data
        self._reviewed = lru_cache(KEPT)(self._review)

    def document(self, flight: str) -> dict[str, Any]:
        """The review's document; beside each fact its evidence as fields that `Flights.series` takes.

        Raises NotThere: no such flight.
        """
        review = self._of(flight)
        document = review.to_dict()
        log = lake_of(self._data, flight).logs[0]
        plots = {fact.key: _curves(log, fact.fields) for fact in review.facts}
        times = {fact.key: fact.to_dict()["at_s"] for fact in review.facts}
        for one in (*document["findings"], *document["actions"]):
            one["plots"] = plots.get(one["fact"], [])
            one["at_s"] = times.get(one["fact"])
        for key, section in document["sections"].items():
            for name, fact in section["facts"].items():
                fact["plots"] = plots[f"{key}.{name}"]
        return document

    def page(self, flight: str) -> str:
        """The whole page; raises NotThere."""
        return render([self._of(flight)])

    def _of(self, flight: str) -> Review:
        log = lake_of(self._data, flight).logs[0]
        return self._reviewed(flight, (self._data / FLIGHTS / log.name / MANIFEST_FILE).stat().st_mtime_ns)

    def _review(self, flight: str, _stamp: int) -> Review:
        log = lake_of(self._data, flight).logs[0]
        read = LoggedFlight(log, log.manifest.damage, log.manifest.source.name)
        return review_flight(read, with_evidence=True)


def _curves(log: StoredLog, addresses: Sequence[str]) -> list[str]:
    """Those addresses that are fields of the log, as the page's plots take them."""
    pairs = [split_address(address) for address in addresses]
    return [
        f"{stream}:{name}"
        for stream, name in pairs
        if stream in log.rows and base_column(name, log.columns(stream))
    ]
