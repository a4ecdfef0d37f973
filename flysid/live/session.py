"""Record links and watch them against a run's models, with a page that shows both."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any

from flysid.ingest.align.recipe import Recipe
from flysid.live.following import Follower
from flysid.live.recording import Recording
from flysid.live.traces import Trace
from flysid.live.watching import ChannelWatch, Notice
from flysid.validate.diagnose.detect import LEVEL_EVERY_S


class Session:
    """A recording with watches beside it.

    `recording`: not yet started.
    `watches`, `recipe`: of a run; none and None to record only.
    """

    def __init__(
        self,
        recording: Recording,
        watches: Sequence[ChannelWatch] = (),
        recipe: Recipe | None = None,
        *,
        kept_s: float = 600.0,
    ) -> None:
        """`kept_s`: of each channel: what a page can still be given."""
        self.recording = recording
        self.watches = watches
        self._events: list[Notice] = []
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._follower: Follower | None = None
        for watch in watches:
            rows = round(kept_s / watch.model.dt_s)
            watch.trace = Trace(len(watch.model.outputs), rows, 2 * round(LEVEL_EVERY_S / watch.model.dt_s))
        if recipe is not None:
            self._follower = Follower(watches, recipe, self._events.append)
            recording.listener = self._follower.listen
            recording.watched = self._follower.states
            self._thread = threading.Thread(
                target=self._follower.run, args=(self._stop,), name="watch", daemon=True
            )

    def start(self) -> None:
        """Begin to record and to watch."""
        self.recording.start()
        if self._thread is not None:
            self._thread.start()

    def stop(self) -> None:
        """Write what has come, close the links; raises what ended the recording early."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        self.recording.stop()

    def describe(self) -> dict[str, Any]:
        """What does not change: channels with their outputs, units, bands."""
        return {
            "links": [link.target.text for link in self.recording.links],
            "channels": [
                {
                    "name": watch.name,
                    "dt_s": watch.model.dt_s,
                    "inputs": [s.name for s in watch.model.inputs],
                    "outputs": [
                        {"name": s.name, "unit": s.unit, "band": limits.band}
                        for s, limits in zip(watch.model.outputs, watch.thresholds, strict=True)
                    ],
                    "can_show": watch.visibility,
                }
                for watch in self.watches
            ],
        }

    def state(self) -> dict[str, Any]:
        """How the links and the file stand."""
        parts = self.recording.parts
        return {
            "file": str(parts.paths[-1]),
            "parts": len(parts.paths),
            "bytes": parts.bytes,
            "frames": parts.frames,
            "refusal": parts.refusal,
            "is_alive": self.recording.is_alive,
            **self.recording.facts(),
        }

    def news(
        self, seen: Mapping[str, int], *, shown_s: float = 60.0
    ) -> tuple[dict[str, Any], dict[str, int]]:
        """What is new to a page that has `seen` so many rows and events, and what it has seen then.

        A page that has seen nothing is given the last minute, and all events.

        `shown_s`: what a page that comes late is given: newer data, not all.
        """
        rows: dict[str, Any] = {}
        known: dict[str, int] = {}
        for watch in self.watches:
            assert watch.trace is not None
            most = None if watch.name in seen else round(shown_s / watch.model.dt_s)
            first, new = watch.trace.since(seen.get(watch.name, 0), most)
            known[watch.name] = first + len(new)
            if known[watch.name] != seen.get(watch.name):
                rows[watch.name] = {"first": first, "rows": new, "nearest": dict(watch.latest)}
        events = self._events[min(seen.get("", 0), len(self._events)) :]
        known[""] = len(self._events)
        return {"channels": rows, "events": [event.to_dict() for event in events]}, known
