"""Bands of a response measured in a closed loop without its reference, against the plant that is known.

`python -m bench.loop_bands SEEDS FIRST`: a lag with dead time under a PI controller, 90 s at 20 Hz; a command
of random steps drives the loop, slow gusts push the output, and what the controller sees is noisy. By the
strength of the gusts (spread over that of the command's steps): how many points of the measured response are
told to be trusted, and how many of those are off the plant by more than 0.5 in ln (4.3 dB, or 29 degrees).
"""

from __future__ import annotations

import sys

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.model.transfer_function import TF
from flysid.validate.transfers.identify import identify_channel

DT_S = 0.05
DELAY = 2
OFF = 0.5


def flown(rng: np.random.Generator, gusts: float, *, samples: int = 1800) -> tuple[Dataset, FloatArray]:
    """What was logged of one loop, and the plant as (gain, pole)."""
    gain = rng.uniform(0.7, 1.5)
    pole = float(np.exp(-DT_S / rng.uniform(0.2, 0.6)))
    p = rng.uniform(0.5, 1.2) / gain
    i = p * DT_S / rng.uniform(0.4, 1.0)
    command = np.repeat(rng.normal(size=samples // 20 + 1), 20)[:samples]
    push = np.zeros(samples)
    for k in range(1, samples):
        push[k] = 0.97 * push[k - 1] + 0.243 * rng.normal()
    push = gusts * push
    noise = 0.01 * rng.normal(size=samples)
    u = np.zeros(samples)
    state = np.zeros(samples)
    y = np.zeros(samples)
    total = 0.0
    for k in range(DELAY + 1, samples):
        state[k] = pole * state[k - 1] + (1.0 - pole) * gain * u[k - DELAY]
        y[k] = state[k] + push[k] + noise[k]
        total += command[k] - y[k]
        u[k] = p * (command[k] - y[k]) + i * total
    segment = Segment(u[:, None], y[:, None], flight="loop")
    return Dataset(DT_S, (Signal("u"),), (Signal("y"),), (segment,), "loop"), np.array([gain, pole])


def plant_at(plant: FloatArray, omega: FloatArray) -> FloatArray:
    """The response of the plant."""
    back = np.exp(-1j * omega * DT_S)
    return np.asarray((1.0 - plant[1]) * plant[0] * back**DELAY / (1.0 - plant[1] * back))


def main(words: list[str]) -> int:
    """Print a line per strength of gusts."""
    seeds, first = (int(w) for w in words)
    for gusts in (0.0, 0.1, 0.3, 1.0, 3.0):
        coherent = told = wrong = wrong_coherent = closed = 0
        for seed in range(first, first + seeds):
            data, plant = flown(np.random.default_rng(seed), gusts)
            found = identify_channel("loop", data, TF())
            measured = found.measured[0]
            closed += found.is_looped(0)
            if measured is None:
                continue
            off = np.abs(np.log(measured.response[:, 0] / plant_at(plant, measured.omega))) > OFF
            inside = measured.trusted(0) > 0
            band = found.band(0, 0)
            kept = (
                inside & (measured.omega >= band[0]) & (measured.omega <= band[1]) if band else inside & False
            )
            coherent += int(inside.sum())
            wrong_coherent += int((inside & off).sum())
            told += int(kept.sum())
            wrong += int((kept & off).sum())
        print(
            f"gusts {gusts:3.1f}: loop seen in {closed} of {seeds}; coherent {coherent} points, "
            f"{wrong_coherent} off; trusted {told}, {wrong} off",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
