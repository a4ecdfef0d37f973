"""Real flights: what gains do, predicted from flights under other gains.

`python -m bench.greenreaper DATA [window]`.

DATA is an ingested folder of ../shared/logs/blackbox/greenreaper_* and hiro_*. Of greenreaper's ten flights
the first four are known and every later one is predicted with the gains that its header states; of hiro's
three every one from the other two. Beside the prediction stand the plant of that flight itself, fitted to it
and flown again like the prediction, the prediction of small motions alone (greenreaper), and "nothing
changed". Told are the median error of the complex response from setpoint to gyro (lines weighed by their
coherence, and all alike), how often the measured response lies in the stated band, the free run (error of
the rate over the whole flight) and the step response (error over 0.2 s, both root mean square); and the
margins over the series. Responses are resolved to one over the window (2 s).
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
from flysid.loops.betaflight import betaflight
from flysid.loops.blackbox_loops import record_of, settings_of
from flysid.loops.controller import Controller
from flysid.loops.flown_axis import FlownAxis, Turning, flown_axis
from flysid.loops.margins import margins
from flysid.loops.prediction import Prediction, Turnings, predict, predict_flight, response_of
from flysid.loops.stick_response import ComplexArray, Loop, closed_loop

BANDS = ((1.0, 4.0), (4.0, 10.0), (10.0, 20.0), (20.0, 35.0))
EARLY = 4
STEP_S = 0.2
STEP_UP_TO_HZ = 40.0


@dataclass(frozen=True, eq=False)
class Flown:
    """One flight of one axis: as it is judged, and as it is flown again."""

    name: str
    loop: Loop
    controller: Controller
    axis: FlownAxis


def flights(lake: Lake, prefix: str, axis: str, window_s: float) -> list[Flown]:
    """Those whose names begin with `prefix`, in their order."""
    found = []
    for log in sorted((x for x in lake.logs if x.name.startswith(prefix)), key=lambda x: x.name):
        settings = settings_of(log)
        record, flown = record_of(log, axis, settings)
        law = betaflight(settings, axis, flown)
        found.append(Flown(log.name, Loop.of([record], window_s), law, flown_axis(log, axis, settings)))
    return found


@dataclass(frozen=True, eq=False)
class Told:
    """One way to say how a flight goes: its response, and its rate where it was flown again."""

    response: ComplexArray
    rate: FloatArray | None = None


def told(early: Sequence[Flown], known: Turnings, flown: Flown) -> tuple[dict[str, Told], Prediction]:
    """The response predicted, of its own plant, of small motions, and as it was before."""
    prediction = predict_flight(known, flown.axis)
    own = plant_of(flown, known)
    again = flown.axis.fly(own)
    before = Loop(flown.loop.f, tuple(b for x in early for b in x.loop.blocks))
    unchanged = flown.axis.fly(known.together, early[-1].axis.law)
    ways = {
        "predicted": Told(prediction.response, flown.axis.fly(known.together).rate),
        "its own plant": Told(response_of(again, known.window_s), again.rate),
        "nothing changed": Told(closed_loop(before.mean), unchanged.rate),
    }
    if len(early) >= 3:
        ways["small motions"] = Told(predict([x.loop for x in early], flown.controller).response)
    return ways, prediction


def plant_of(flown: Flown, known: Turnings) -> Turning:
    """Of one flight, where its sticks show it; else in the band in which the known flights do."""
    try:
        return Turnings.of([flown.axis], known.window_s).together
    except DataError:
        return Turnings.of([flown.axis], known.window_s, known.band_hz).together


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


def step(response: ComplexArray, f: FloatArray) -> FloatArray:
    """The first `STEP_S` after a step of the setpoint, of what is below `STEP_UP_TO_HZ`."""
    taper = np.cos(0.5 * np.pi * np.minimum(f / STEP_UP_TO_HZ, 1.0)) ** 2
    whole = np.concatenate([[response[1].real], response[1:]])
    size = 2 * (len(f) - 1)
    return np.asarray(np.cumsum(np.fft.irfft(whole * taper, size))[: round(STEP_S * 2.0 * f[-1])])


def errors(told_so: Told, flown: Flown) -> dict[str, list[float]]:
    """Of one way: by bands, weighed and not; then free run and step."""
    f = flown.loop.f
    measured = closed_loop(flown.loop.mean)
    gap = np.abs(told_so.response - measured) / np.abs(measured)
    trust = coherence(flown.loop)
    at = [(f >= low) & (f < high) for low, high in BANDS]
    apart = float(np.sqrt(np.mean((step(told_so.response, f) - step(measured, f)) ** 2)))
    free = np.nan
    if told_so.rate is not None:
        free = float((told_so.rate - flown.axis.rate).std() / flown.axis.rate.std())
    weighed = [median(gap[band], trust[band]) for band in at]
    alike = [float(np.median(gap[band])) for band in at]
    return {"": [*weighed, free, apart], ", all lines alike": [*alike, np.nan, np.nan]}


def series(lake: Lake, prefix: str, axis: str, early: int, window_s: float) -> None:
    """The table of one set of flights; `early` of 0: every flight from all others."""
    every = flights(lake, prefix, axis, window_s)
    trials = [(every[:early], later) for later in every[early:]]
    if not early:
        trials = [([x for x in every if x is not one], one) for one in every]
    rows: dict[str, list[list[float]]] = {}
    inside = []
    known = [Turnings.of([x.axis for x in one], window_s) for one, _ in trials[: 1 if early else None]]
    for i, (before, later) in enumerate(trials):
        ways, prediction = told(before, known[0 if early else i], later)
        for name, way in ways.items():
            for how, row in errors(way, later).items():
                rows.setdefault(name + how, []).append(row)
        good = held(prediction, later)
        f = later.loop.f
        inside.append([float(good[(f >= low) & (f < high)].mean()) for low, high in BANDS])
    print(f"\n{prefix} {axis}: {len(trials[0][0])} flights known, {len(trials)} predicted; " + _words())
    for one in known:
        print(f"  {one.together}, fitted from {one.band_hz[0]:.1f} to {one.band_hz[1]:.1f} Hz")
    for name, values in rows.items():
        print(f"  {name:34s} " + "  ".join(f"{100 * v:5.1f} %" for v in np.median(values, axis=0)))
    print(f"  {'in the 95 % band':34s} " + "  ".join(f"{100 * v:5.1f} %" for v in np.mean(inside, axis=0)))
    for flown in every:
        print(f"  {flown.name[:24]:24s} {_margins(flown)}")


def _words() -> str:
    bands = ", ".join(f"{low:.0f} to {high:.0f} Hz" for low, high in BANDS)
    return f"median error at {bands}; free run; step"


def _margins(flown: Flown) -> str:
    gains = ", ".join(f"{k} {v:g}" for k, v in flown.controller.gains.items())
    gains += f", steps {flown.axis.slower:.3f} times those stated"
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
        series(lake, "hiro", axis, 0, window_s)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
