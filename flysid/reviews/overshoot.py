"""How far a loop overshoots its setpoint, from the step response that ordinary flying shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flysid.dataset import Dataset, Segment, Signal
from flysid.errors import DataError
from flysid.model.polynomials import Z95
from flysid.reviews.follow import Counting, on_grid
from flysid.reviews.pairs import Pair


@dataclass(frozen=True)
class Overshoot:
    """Percent of a step beyond it, with its 95 % interval; `why` it is not known where it is NaN."""

    percent: float = float("nan")
    interval: tuple[float, float] | None = None
    why: str = ""


def overshoot(
    pair: Pair, counts: Counting, *, fastest_hz: float = 125.0, taps: int = 60, widest: float = 30.0
) -> Overshoot:
    """Of a loop, within the longest lag that is looked for.

    Parameters
    ----------
    fastest_hz, taps : what the response is resolved to: it has to be cheap.
    widest : percent to either side: an interval beyond determines nothing.
    """
    from flysid.model.step_response import step_response

    together = on_grid(pair, counts, fastest_hz=fastest_hz)
    period = 1.0 / min(pair.rate_hz, fastest_hz)
    segments = tuple(
        Segment(together.setpoint[run, None], together.measured[run, None])
        for run in together.flown
        if run.stop - run.start > taps
    )
    if not segments:
        return Overshoot(why="too little flight without a pause")
    unit = pair.loop.unit
    data = Dataset(period, (Signal("setpoint", unit),), (Signal("measured", unit),), segments)
    try:
        found = step_response(data, horizon_s=0.6 * pair.search_s, most_taps=taps, rounds=2, anyway=True)
    except DataError as error:
        return Overshoot(why=error.message)
    top = int(np.argmax(found.step))
    beyond, reach = (100.0 * float(part) for part in (found.step[top] - 1.0, Z95 * found.error[top]))
    if reach > widest:
        return Overshoot(why=f"between {beyond - reach:.0f} and {beyond + reach:.0f} %")
    return Overshoot(max(beyond, 0.0), (max(beyond - reach, 0.0), max(beyond + reach, 0.0)))
