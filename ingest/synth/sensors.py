"""Instruments: own rate, latency, noise, bias, quantisation, drop-outs. Truth in, samples out, seeded.

Rates and noises of the presets: motion capture 120 Hz and below a millimetre (the paper's Vicon); AR.Drone
navdata 200 Hz, or 15 Hz with navdata_demo; autopilot telemetry 4 to 50 Hz, an autopilot's own log 50 Hz with
gyros of 0.3 deg/s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.ingest.formats.common.clock import SECOND_NS
from flysid.ingest.synth.telemetry import IntArray, Telemetry


@dataclass(frozen=True)
class Sensor:
    """What stands between a quantity and its log.

    `rate_hz`: samples per second; their times are whole milliseconds, as most formats have them.
    `noise`: standard deviation of white noise, per quantity.
    `bias`: standard deviation of a constant offset, drawn per flight, per quantity.
    `resolution`: smallest step shown, per quantity; 0 for none.
    `latency_s`: age of a value when it is stamped.
    `loss`: share of samples that never arrive.
    """

    rate_hz: float
    noise: Mapping[str, float]
    bias: Mapping[str, float]
    resolution: Mapping[str, float]
    latency_s: float = 0.0
    loss: float = 0.0

    def __post_init__(self) -> None:
        if not (0.0 < self.rate_hz <= 1000.0 and 0.0 <= self.loss < 1.0 and self.latency_s >= 0.0):
            raise UsageError(
                f"no sensor with {self.rate_hz:g} Hz, latency {self.latency_s:g} s, loss {self.loss:g}"
            )


def velocity_sensor(rate_hz: float, noise_m_s: float) -> Sensor:
    """Velocities with noise, all else as it is."""
    return Sensor(rate_hz, dict.fromkeys(("vx", "vy", "vz"), noise_m_s), {}, {})


MOTION_CAPTURE = Sensor(
    120.0, dict.fromkeys("xyz", 2e-4) | dict.fromkeys(("phi", "theta", "psi"), 0.05), {}, {}, latency_s=0.008
)
NAVDATA = Sensor(
    200.0,
    dict.fromkeys(("vx", "vy"), 0.03) | {"vz": 0.05, "z": 0.01} | dict.fromkeys(("phi", "theta", "psi"), 0.1),
    dict.fromkeys(("phi", "theta"), 0.3),
    dict.fromkeys("xyz", 1e-3) | dict.fromkeys(("phi", "theta", "psi"), 1e-3),
    latency_s=0.02,
)
NAVDATA_DEMO = Sensor(15.0, NAVDATA.noise, NAVDATA.bias, NAVDATA.resolution, NAVDATA.latency_s, loss=0.002)
TELEMETRY = velocity_sensor(50.0, 0.02)
AUTOPILOT = Sensor(
    50.0, dict.fromkeys(("vx", "vy", "vz"), 0.02) | dict.fromkeys(("p", "q", "r"), 0.3), {}, {}
)
TELEMETRY_SLOW = Sensor(4.0, TELEMETRY.noise, {}, dict.fromkeys(("vx", "vy", "vz"), 0.01), loss=0.01)

SENSORS: Mapping[str, Sensor] = {
    "telemetry": TELEMETRY,
    "telemetry-slow": TELEMETRY_SLOW,
    "autopilot": AUTOPILOT,
    "navdata": NAVDATA,
    "navdata-demo": NAVDATA_DEMO,
    "motion-capture": MOTION_CAPTURE,
}


def sample_times_ns(first_ns: int, last_ns: int, rate_hz: float) -> IntArray:
    """Times from first to last at a rate, each rounded to its millisecond."""
    count = int((last_ns - first_ns) * 1e-9 * rate_hz + 1e-9) + 1
    milliseconds = np.round(np.arange(count) * (1000.0 / rate_hz)).astype(np.int64)
    return np.asarray(first_ns + 1_000_000 * milliseconds, dtype=np.int64)


def observe(truth: Telemetry, sensor: Sensor, rng: np.random.Generator) -> Telemetry:
    """What the sensor says about every quantity of `truth`.

    Between the truth's samples values are interpolated linearly; before its first one they stand still.
    """
    time_ns = sample_times_ns(int(truth.time_ns[0]), int(truth.time_ns[-1]), sensor.rate_hz)
    time_ns = time_ns[rng.random(len(time_ns)) >= sensor.loss] if sensor.loss else time_ns
    seen_ns = time_ns - round(sensor.latency_s * SECOND_NS)
    since = (seen_ns - truth.time_ns[0]).astype(np.float64)
    grid = (truth.time_ns - truth.time_ns[0]).astype(np.float64)
    return Telemetry(
        time_ns,
        {
            name: _blur(np.interp(since, grid, values), name, sensor, rng)
            for name, values in truth.values.items()
        },
    )


def _blur(exact: FloatArray, name: str, sensor: Sensor, rng: np.random.Generator) -> FloatArray:
    """Bias, noise, then the step of the display."""
    value = exact
    if sensor.bias.get(name):
        value = value + sensor.bias[name] * rng.standard_normal()
    if sensor.noise.get(name):
        value = value + sensor.noise[name] * rng.standard_normal(len(exact))
    step = sensor.resolution.get(name, 0.0)
    return np.round(value / step) * step if step else value
