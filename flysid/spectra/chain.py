"""The filters between sensor and controller in their order, each with the rate it runs at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from flysid.dataset import FloatArray
from flysid.spectra.stages import ComplexArray, Stage, run_sections

AtTimes = Callable[[FloatArray], Stage]
REMEDY = (
    "switch them off for one flight; Betaflight 4.5 and later log the motors' RPM with bidirectional DShot"
)


@dataclass(frozen=True, eq=False)
class Step:
    """A filter of a chain.

    `stage`: its law; on average where it moves.
    `rate_hz`: how often it runs.
    `words`: the parameters that state it, as the firmware names them.
    `at`: the stage at times (s, on the log's clock), for one that follows the throttle or a motor; else None.
    """

    stage: Stage
    rate_hz: float
    words: str
    at: AtTimes | None = None

    def sections(self, time_s: FloatArray) -> list[FloatArray]:
        """Coefficients at the times at which it runs."""
        return (self.at(time_s) if self.at else self.stage).sections(self.rate_hz)


@dataclass(frozen=True, eq=False)
class Chain:
    """Filters of one sensor.

    `steps`: in the order in which the signal passes them; a later one never runs faster.
    `unknown`: filters that were on but whose frequencies the log does not hold, a sentence each.
    `idle`: filters that are set but did not run, a sentence each.
    `remedy`: what would make the unknown ones known.

    >>> from flysid.spectra.stages import Kind
    >>> chain = Chain((Step(Stage(Kind.BIQUAD, 40.0), 1000.0, "IMU_GYRO_CUTOFF 40"),))
    >>> round(1000.0 * chain.delay_s(10.0), 1), round(chain.phase_deg(30.0))
    (5.8, -67)
    """

    steps: tuple[Step, ...]
    unknown: tuple[str, ...] = field(default=())
    idle: tuple[str, ...] = field(default=())
    remedy: str = REMEDY

    def response(self, hz: FloatArray) -> ComplexArray:
        """(F,) gain and phase of all of them together, as complex numbers."""
        through: ComplexArray = np.ones(len(hz), dtype=np.complex128)
        for step in self.steps:
            through = through * step.stage.response(hz, step.rate_hz)
        return through

    def phase_deg(self, hz: float) -> float:
        """By how much the signal turns at a frequency, counted from 0 Hz on; negative: it is late."""
        up_to = np.linspace(0.0, hz, 200)
        return float(np.degrees(np.unwrap(np.angle(self.response(up_to)))[-1]))

    def delay_s(self, hz: float) -> float:
        """By how much a tone of this frequency is late."""
        return -self.phase_deg(hz) / (360.0 * hz)

    def noise_left(self, hz: FloatArray, density: FloatArray) -> float:
        """RMS of what passes, of a signal of this density (its unit squared per Hz, at even frequencies)."""
        return float(np.sqrt(np.sum(density * np.abs(self.response(hz)) ** 2) * (hz[1] - hz[0])))

    def run(self, time_s: FloatArray, x: FloatArray, start_hz: float) -> FloatArray:
        """(M,) what comes out of the last filter, at the rate of the last filter, of x at a rate.

        `time_s`, `x`: (N,) at even times; what the first filter runs on.
        `start_hz`: their rate; the rates of the steps divide it.
        """
        rate = start_hz
        for step in self.steps:
            every = round(rate / step.rate_hz)
            if every > 1:
                time_s, x = time_s[every - 1 :: every], x[every - 1 :: every]
                rate /= every
            x = run_sections(step.sections(time_s), x)
        return x

    def with_steps(self, more: Sequence[Step]) -> Chain:
        """This chain with more filters behind it."""
        return replace(self, steps=(*self.steps, *more))

    @property
    def fastest_hz(self) -> float:
        """The rate of the first filter; 0 of no filters."""
        return max((step.rate_hz for step in self.steps), default=0.0)

    @property
    def slowest_s(self) -> float:
        """How long the filter with the lowest frequency remembers: the time constant of its edge."""
        edges = [float(np.min(s.stage.hz)) / (2.0 * float(np.max(s.stage.q))) for s in self.steps]
        return 1.0 / (np.pi * min(edges)) if edges else 0.0
