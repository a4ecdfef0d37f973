"""Real flights: what gains do, predicted from flights under other gains.

`python -m bench.greenreaper DATA [window]`.

DATA is an ingested folder of ../shared/logs/blackbox/greenreaper_* and hiro_*. From the first four flights of
greenreaper, the closed loop from setpoint to gyro of every later one with the gains that its header states:
median error of the complex response (lines weighed by their coherence, and all alike), beside that of the
plant of that flight itself and of "nothing changed"; how often the measured response lies in the stated
band; and the margins over the series. Responses are resolved to one over the window (2 s).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.ingest.lake.lake import Lake
from flysid.ingest.lake.lake import open as open_lake
from flysid.loops.blackbox_loops import record_of, settings_of
from flysid.loops.controller import Controller, betaflight
from flysid.loops.margins import margins
from flysid.loops.prediction import Prediction, predict
from flysid.loops.stick_response import ComplexArray, Loop, closed_loop, plant

BANDS = ((1.0, 4.0), (4.0, 10.0), (10.0, 20.0), (20.0, 35.0))
EARLY = 4


@dataclass(frozen=True, eq=False)
class Flown:
    """One flight of one axis."""

    name: str
    loop: Loop
    controller: Controller


def flights(lake: Lake, prefix: str, axis: str, window_s: float) -> list[Flown]:
    """Those whose names begin with `prefix`, in their order."""
    found = []
    for log in sorted((x for x in lake.logs if x.name.startswith(prefix)), key=lambda x: x.name):
        settings = settings_of(log)
        record, throttle = record_of(log, axis, settings)
        loop = Loop.of([record], window_s)
        found.append(Flown(log.name, loop, betaflight(settings, axis, throttle).as_flown(loop, 2.0, 30.0)))
    return found


def told(early: Sequence[Flown], flown: Flown) -> dict[str, ComplexArray]:
    """The response predicted, with its own plant, and as it was before."""
    f = flown.loop.f
    c = flown.controller
    own = plant(flown.loop.mean)
    known = np.asarray(sum(x.loop.mean for x in early))
    before = closed_loop(known)
    pooled = plant(known)
    predicted = pooled * c.reference(f) / (1.0 + pooled * c.feedback(f))
    return {
        "predicted": predict([x.loop for x in early], c).response if len(early) >= 3 else predicted,
        "own fit": own * c.reference(f) / (1.0 + own * c.feedback(f)),
        "nothing changed": before,
    }


def held(prediction: Prediction, flown: Flown) -> FloatArray:
    """(F,) whether the measured response lies in the band, its own scatter added."""
    measured = closed_loop(flown.loop.mean)
    scatter = closed_loop(flown.loop.draws) - measured
    away = np.abs(prediction.draws + scatter - prediction.response)
    inside = np.abs(measured - prediction.response) <= np.quantile(away, 0.95, axis=0)
    return inside.astype(np.float64)


def coherence(loop: Loop) -> FloatArray:
    """(F,) of setpoint and rate."""
    s = loop.mean
    return np.asarray(np.abs(s[0, 2]) ** 2 / (s[0, 0].real * s[2, 2].real))


def median(values: FloatArray, weight: FloatArray) -> float:
    """The value with half of the weight on either side."""
    order = np.argsort(values)
    below = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(below, 0.5 * below[-1])])


def series(lake: Lake, prefix: str, axis: str, early: int, window_s: float) -> None:
    """The table of one set of flights."""
    every = flights(lake, prefix, axis, window_s)
    known = every[:early]
    later = every[early:]
    errors: dict[str, list[list[float]]] = {}
    inside = []
    for flown in later:
        measured = closed_loop(flown.loop.mean)
        at = [(flown.loop.f >= low) & (flown.loop.f < high) for low, high in BANDS]
        trust = coherence(flown.loop)
        for name, response in told(known, flown).items():
            gap = np.abs(response - measured) / np.abs(measured)
            for how, weight in (("", trust), (", all lines alike", np.ones_like(trust))):
                row = [median(gap[band], weight[band]) for band in at]
                errors.setdefault(name + how, []).append(row)
        if len(known) >= 3:
            good = held(predict([x.loop for x in known], flown.controller), flown)
            inside.append([float(good[band].mean()) for band in at])
    print(f"\n{prefix} {axis}: {len(known)} flights known, {len(later)} predicted; " + _words())
    for name, rows in errors.items():
        print(f"  {name:32s} " + "  ".join(f"{100 * v:5.1f} %" for v in np.median(rows, axis=0)))
    if inside:
        print(
            f"  {'in the 95 % band':32s} " + "  ".join(f"{100 * v:5.1f} %" for v in np.mean(inside, axis=0))
        )
    for flown in every:
        print(f"  {flown.name[:24]:24s} {_margins(flown)}")


def _words() -> str:
    return "median error at " + ", ".join(f"{low:.0f} to {high:.0f} Hz" for low, high in BANDS)


def _margins(flown: Flown) -> str:
    gains = ", ".join(f"{k} {v:g}" for k, v in flown.controller.gains.items())
    try:
        m = margins(flown.loop, flown.controller)
    except DataError as error:
        return f"{gains}: {error.message}"
    miss = flown.controller.miss(flown.loop, *m.band_hz)
    crossing = (
        f"crossover {m.crossover_hz.said('.1f', ' Hz')}, phase margin {m.phase_deg.said('.0f', ' deg')}"
    )
    rest = f"gain margin {m.gain_db.said('.1f', ' dB')}, Ms {m.ms.said('.2f')}"
    return f"{gains}: {crossing}, {rest}, controller {100 * miss:.0f} % off"


def main(arguments: list[str]) -> int:
    """Roll and pitch of both sets."""
    lake = open_lake(arguments[0])
    window_s = float(arguments[1]) if len(arguments) > 1 else 2.0
    for axis in ("roll", "pitch"):
        series(lake, "greenreaper", axis, EARLY, window_s)
        series(lake, "hiro", axis, 1, window_s)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
