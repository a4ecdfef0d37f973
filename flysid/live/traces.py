"""The latest samples of a watched channel, for pages that plot them."""

from __future__ import annotations

import threading

import numpy as np

from flysid.dataset import FloatArray


class Trace:
    """A ring of rows; written by the thread that watches, read by any other.

    A row holds the time in s, the measured outputs, the outputs expected one step ahead, and the outputs of
    the free run begun a few seconds before. The free run is known later than the rest: `settles` rows from
    the end may still change.

    `outputs`: how many.
    `capacity`: rows to keep.
    `settles`: rows that a free run fills in afterwards, at most.

    >>> trace = Trace(outputs=1, capacity=100, settles=2)
    >>> trace.add(0.0, 0.5, np.array([[1.0], [2.0]]), np.array([[1.1], [1.9]]))
    >>> trace.since(0)
    (0, [[0.0, 1.0, 1.1, None], [0.5, 2.0, 1.9, None]])
    """

    def __init__(self, outputs: int, capacity: int, settles: int) -> None:
        self.settles = settles
        self._outputs = outputs
        self._rows = np.full((capacity, 1 + 3 * outputs), np.nan)
        self._count = 0
        self._guard = threading.Lock()

    def add(self, time_s: float, dt_s: float, y: FloatArray, expected: FloatArray) -> None:
        """Append samples; `time_s` is that of the first. Of more than fit, the last are kept."""
        n = min(len(y), len(self._rows))
        skipped = len(y) - n
        times = time_s + dt_s * np.arange(skipped, len(y))
        with self._guard:
            at = np.arange(self._count + skipped, self._count + len(y)) % len(self._rows)
            self._rows[at] = np.nan
            self._rows[at, 0] = times
            self._rows[at, 1 : 1 + self._outputs] = y[skipped:]
            self._rows[at, 1 + self._outputs : 1 + 2 * self._outputs] = expected[skipped:]
            self._count += len(y)

    def add_run(self, free: FloatArray) -> None:
        """The free run along the last rows, of which the last `settles` are taken."""
        with self._guard:
            n = min(len(free), self.settles, self._count)
            at = np.arange(self._count - n, self._count) % len(self._rows)
            self._rows[at, 1 + 2 * self._outputs :] = free[len(free) - n :]

    def since(self, seen: int, most: int | None = None) -> tuple[int, list[list[float | None]]]:
        """The number of the first row and the rows that one who has seen `seen` of them needs.

        Rows that may have changed come again. Of more than `most` only the newest.
        """
        with self._guard:
            kept = len(self._rows) if most is None else min(most, len(self._rows))
            first = max(0, min(seen, self._count) - self.settles, self._count - kept)
            rows = self._rows[np.arange(first, self._count) % len(self._rows)]
        return first, [[float(x) if np.isfinite(x) else None for x in row] for row in rows]
