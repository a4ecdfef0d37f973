"""The gyro's filters of PX4 (1.12 and later), from parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.spectra.chain import AtTimes, Chain, Step
from flysid.spectra.settings import Moving, thinned
from flysid.spectra.stages import Kind, Stage

BY_ESC = 1
BY_SPECTRUM = 2
"""Bits of IMU_GYRO_DNF_EN: what dynamic notches follow."""
CUTOFF = "IMU_GYRO_CUTOFF"


def px4_chain(stated: Mapping[str, float], rate_hz: float, motors_hz: Sequence[Moving] = ()) -> Chain:
    """The filters between the gyro and the rate controller.

    `stated`: parameters by name.
    `rate_hz`: at which the gyro is sampled and filtered.
    `motors_hz`: turns a second of each motor, where the log holds them.
    Raises DataError: the parameters are not those of a PX4 that filters in this way.
    """
    if CUTOFF not in stated:
        raise DataError(
            f"the log does not state {CUTOFF}", hint="log the parameters: PX4 1.10 and later have it"
        )
    steps: list[Step] = []
    unknown: list[str] = []
    dynamic = int(stated.get("IMU_GYRO_DNF_EN", 0.0))
    if dynamic & BY_ESC and motors_hz:
        steps += _of_motors(stated, rate_hz, motors_hz)
    elif dynamic & BY_ESC:
        unknown.append("notches follow the ESCs (IMU_GYRO_DNF_EN): the log does not hold the motors' RPM")
    if dynamic & BY_SPECTRUM:
        unknown.append("notches follow the onboard FFT (IMU_GYRO_DNF_EN): the log holds a part of its peaks")
    for number in (0, 1):
        hz = stated.get(f"IMU_GYRO_NF{number}_FRQ", 0.0)
        width = stated.get(f"IMU_GYRO_NF{number}_BW", 0.0)
        if 0.0 < hz < rate_hz / 2.0 and width > 0.0:
            words = f"IMU_GYRO_NF{number}_FRQ {hz:g}, IMU_GYRO_NF{number}_BW {width:g}"
            steps.append(Step(_notch(hz, width, rate_hz), rate_hz, words))
    cut = stated[CUTOFF]
    if 0.0 < cut < rate_hz / 2.0:
        steps.append(Step(Stage(Kind.BIQUAD, cut), rate_hz, f"{CUTOFF} {cut:g}"))
    return Chain(tuple(steps), tuple(unknown))


def _notch(hz: float | FloatArray, width_hz: float, rate_hz: float) -> Stage:
    """PX4 states a width, and bends it as the frequencies are bent."""
    bent = np.tan(np.pi * width_hz / rate_hz)
    return Stage(Kind.NOTCH, hz, q=np.sin(2.0 * np.pi * np.asarray(hz) / rate_hz) / (2.0 * bent))


def _of_motors(stated: Mapping[str, float], rate_hz: float, motors_hz: Sequence[Moving]) -> list[Step]:
    width = stated.get("IMU_GYRO_DNF_BW", 15.0)
    lowest = stated.get("IMU_GYRO_DNF_MIN", 25.0)
    found = []
    for number, motor in enumerate(motors_hz, 1):
        for harmonic in range(1, int(stated.get("IMU_GYRO_DNF_HMC", 3.0)) + 1):
            at = _follow(motor, harmonic, width, lowest, rate_hz)
            words = f"IMU_GYRO_DNF of motor {number}, harmonic {harmonic}"
            found.append(Step(at(thinned(motor)), rate_hz, words, at))
    return found


def _follow(motor: Moving, harmonic: int, width_hz: float, lowest: float, rate_hz: float) -> AtTimes:
    def at(time_s: FloatArray) -> Stage:
        turns = np.nan_to_num(motor.held(time_s))
        hz = np.maximum(harmonic * turns, lowest)
        on = (turns > 0.0) & (hz < rate_hz / 2.0)
        stage = _notch(np.where(on, hz, rate_hz / 4.0), width_hz, rate_hz)
        return Stage(Kind.NOTCH, stage.hz, stage.q, weight=on.astype(np.float64))

    return at
