"""`python -m bench.watch_real [RATE_HZ]`: a watch of a real vehicle, thresholds from one half of its flights.

Ten flights of one quadrotor (../shared/logs/blackbox), setpoint to body rate, at 50 Hz. Models are fitted to
flights 1 to 3, thresholds come from 4 and 5 at 0.1 false alarms an hour of the vehicle; every event of
flights 6 to 10 is printed, and beside each alarm what the input and the error were meanwhile.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from bench.flight_luck import CHANNELS, real_flights
from flysid.dataset import Dataset, Segment
from flysid.live.watching import ChannelWatch, Notice, known_inputs
from flysid.model.arx import ARX
from flysid.validate.diagnose.detect import DETECTORS, calibrate, one_step

FALSE_ALARMS_1_H = 0.1
TRAINING = 3
CALIBRATION = 5


def watched(data: Dataset) -> tuple[ChannelWatch, list[Segment], str]:
    """The watch of a channel, the segments to look at, and what it rests on."""
    names = sorted({segment.flight for segment in data.segments}, key=lambda n: (len(n), n))
    parts = [[s for s in data.segments if s.flight in group] for group in _groups(names)]
    model = ARX().fit(replace(data, segments=tuple(parts[0])))
    share = FALSE_ALARMS_1_H / len(CHANNELS) / len(DETECTORS)
    limits = calibrate(model, parts[1], share)
    minutes = [sum(map(len, part)) * data.dt_s / 60.0 for part in parts]
    told = f"fitted to {minutes[0]:.1f} min, thresholds from {minutes[1]:.1f}, {minutes[2]:.1f} min watched"
    return ChannelWatch(data.name, model, limits, known_inputs(parts[0])), parts[2], told


def _groups(names: list[str]) -> list[list[str]]:
    return [names[:TRAINING], names[TRAINING:CALIBRATION], names[CALIBRATION:]]


def around(watch: ChannelWatch, segment: Segment, event: Notice) -> str:
    """How hard the vehicle was flown when an alarm came, and how large the errors were."""
    at = round((event.time_s - segment.t0_ns * 1e-9) / watch.model.dt_s)
    before = slice(max(0, at - round(2.0 / watch.model.dt_s)), at + 1)
    error = one_step(watch.model, segment.u, segment.y)[before, 0] / watch.thresholds[0].sigma
    usual = float(np.abs(segment.u[:, 0]).mean())
    return (
        f"the 2 s before: setpoint up to {np.abs(segment.u[before, 0]).max():.0f} "
        f"(mean of the flight {usual:.0f}), errors up to {np.abs(error).max():.1f} sigma"
    )


def main() -> None:
    """Print what every channel says."""
    for data in real_flights(float(sys.argv[1]) if len(sys.argv) > 1 else 50.0):
        watch, segments, told = watched(data)
        print(f"\n{data.name}: {told}", flush=True)
        for segment in segments:
            for event in watch.run(segment):
                print(f"  {segment.flight} {event.time_s:.1f} s {event.kind}: {event.text}")
                if event.kind == "alarm":
                    print(f"    {around(watch, segment, event)}", flush=True)


if __name__ == "__main__":
    main()
