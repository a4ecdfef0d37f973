"""A chain of filters run again on the raw signal of a log, and compared with what the firmware logged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.spectra.chain import Chain


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of a log without a gap: raw and filtered signal of one axis.

    `time_s`: (N,) on the log's clock.
    `raw`, `filtered`: (N,) filtered is NaN in rows in which it was not logged.
    """

    time_s: FloatArray
    raw: FloatArray
    filtered: FloatArray


@dataclass(frozen=True)
class Replayed:
    """How well a chain gives what was logged.

    `removed`: RMS of raw less filtered, in the signal's unit.
    `error`: RMS of replayed less filtered.
    `floor`: what rounding in the log makes of the error at least.
    `rows`: that were compared.
    """

    removed: float
    error: float
    floor: float
    rows: int

    @property
    def share(self) -> float:
        """The error over what the chain removed; 1 is no better than no filter at all."""
        return self.error / self.removed if self.removed > 0.0 else float("inf")

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "removed_rms": self.removed,
            "error_rms": self.error,
            "error_of_removed": self.share if self.removed > 0.0 else None,
            "floor_of_removed": self.floor / self.removed if self.removed > 0.0 else None,
            "rows": self.rows,
        }


def replay(chain: Chain, rows: Rows, row_hz: float) -> FloatArray:
    """(N,) the filtered signal at a log's rows.

    Between rows the raw signal is taken on straight lines; what it did there is not in the log.

    `row_hz`: rows a second.
    """
    if not chain.steps:
        return rows.raw
    fine = max(1, round(chain.fastest_hz / row_hz))
    count = (len(rows.raw) - 1) * fine + 1
    place = np.arange(1 - fine, count) / fine
    index = np.arange(len(rows.raw), dtype=np.float64)
    x = np.interp(place, index, rows.raw)
    time_s = np.interp(place, index, rows.time_s)
    out = chain.run(time_s, x, row_hz * fine)
    left = max(1, round(chain.steps[-1].rate_hz / row_hz))
    return out[left - 1 :: left]


def compare(chain: Chain, pieces: Sequence[Rows], row_hz: float, step: float) -> Replayed:
    """The replay of all pieces against what was logged, after the filters have settled.

    Parameters
    ----------
    step : to which the log rounds both signals; 0 where it does not.

    Raises
    ------
    DataError : frequencies of the chain are not in the log, or no piece is long enough.
    """
    if chain.unknown:
        raise DataError("; ".join(chain.unknown), hint=chain.remedy)
    settled = int(np.ceil(3.0 * chain.slowest_s * row_hz))
    errors, removed, weight = 0.0, 0.0, 0
    for rows in pieces:
        if len(rows.raw) <= 2 * settled:
            continue
        kept = np.isfinite(rows.filtered)
        kept[:settled] = False
        errors += float(np.sum((replay(chain, rows, row_hz) - rows.filtered)[kept] ** 2))
        removed += float(np.sum((rows.raw - rows.filtered)[kept] ** 2))
        weight += int(kept.sum())
    if not weight:
        raise DataError(
            "no stretch of the log is long enough to replay the filters", hint="log without losses"
        )
    impulse = replay(chain, Rows(np.zeros(256), np.eye(1, 256, 128)[0], np.zeros(256)), row_hz)
    floor = step / np.sqrt(12.0) * np.sqrt(1.0 + np.sum(impulse**2))
    return Replayed(float(np.sqrt(removed / weight)), float(np.sqrt(errors / weight)), float(floor), weight)
