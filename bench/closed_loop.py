"""Closed loops: what a response measured through the reference holds, beside the direct one.

`python -m bench.closed_loop [response|poles|iv|all] [runs] [first seed]`: a rate loop with a chirp added
behind its controller, as ArduPilot's mixer axes do; plant 3333 / (s (s + 33.3)), dead time 7.5 ms, P + I, a
coloured disturbance of 0.1, 0.15 or 0.2 at the plant's input (the chirp's amplitude is 0.5) and gyro noise.
Everything is by default; of the direct response a tenth of the runs is enough.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FlysidError
from flysid.ingest.synth.manoeuvres import chirp
from flysid.model.frequency.continuous_transfer import ContinuousTransfer
from flysid.model.frequency.rational import Rational, hold_response
from flysid.model.frequency.response import MeasuredResponse, measure_response
from flysid.model.frequency.sampling import sample
from flysid.model.frequency.transfer import continuous
from flysid.model.iv import IV
from flysid.model.polynomials import ComplexArray
from flysid.model.transfer_function import TF

PLANT = Rational(np.array([1.0, 33.3, 0.0]), (np.array([3333.0]),), np.array([0.0075]))
SWEPT_HZ = (0.5, 12.0)
AMPLITUDE = 0.5
GYRO_NOISE = 0.5
P_GAIN = 0.18
I_GAIN = 0.36
DISTURBANCES = (0.1, 0.15, 0.2)


@dataclass(frozen=True)
class Loop:
    """One record of the loop.

    Attributes
    ----------
    disturbance : standard deviation at the plant's input, time constant 0.3 s.
    """

    disturbance: float
    rate_hz: float = 400.0
    seconds: float = 60.0

    def flown(self, seed: int) -> Dataset:
        """Inputs u (what the plant gets) and chirp, output rate."""
        rng = np.random.default_rng(seed)
        n = round(self.seconds * self.rate_hz)
        dt = 1.0 / self.rate_hz
        t = np.arange(n) * dt
        added = chirp(t, SWEPT_HZ, AMPLITUDE)
        pole = np.exp(-dt / 0.3)
        d = np.asarray(lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], rng.standard_normal(n + 4000)))[4000:]
        noise = GYRO_NOISE * rng.standard_normal(n)
        a, taps = sample(PLANT, dt, "zero")
        integrator = np.array([1.0, -1.0])
        law = np.array([P_GAIN + I_GAIN * dt, -P_GAIN])  # P + I over 1 - 1/q
        top = np.convolve(taps[0], integrator)
        back = np.convolve(taps[0], law)
        size = max(len(a) + 1, len(back))
        bottom = _padded(np.convolve(a, integrator), size) + _padded(back, size)
        rate = lfilter(top, bottom, added + self.disturbance * d) - lfilter(back, bottom, noise) + noise
        u = added - lfilter(law, integrator, rate)
        return Dataset.from_arrays(
            np.column_stack([u, added]), rate, dt, inputs=["u", "chirp"], outputs=["rate"]
        )


def _padded(values: FloatArray, size: int) -> FloatArray:
    return np.append(values, np.zeros(size - len(values)))


def direct(data: Dataset) -> Dataset:
    """The record without its chirp."""
    return Dataset.from_arrays(
        [s.u[:, 0] for s in data.segments],
        [s.y for s in data.segments],
        data.dt_s,
        inputs=["u"],
        outputs=["rate"],
    )


def truth(omega: FloatArray, dt_s: float) -> ComplexArray:
    """(F,) the plant behind its hold."""
    return np.asarray(PLANT.at(omega)[:, 0] * hold_response(omega, dt_s, "zero"))


def held(measured: MeasuredResponse, low: float, high: float) -> tuple[int, int, FloatArray]:
    """(points of gain and phase within their intervals, all of them, errors of gain in dB) inside a band."""
    inside = (measured.omega >= low) & (measured.omega <= high)
    error = np.log(measured.response[:, 0] / truth(measured.omega, measured.dt_s))[inside]
    width = measured.half_width()[inside, 0]
    hits = np.count_nonzero(np.abs(error.real) <= width) + np.count_nonzero(np.abs(error.imag) <= width)
    return int(hits), 2 * len(error), np.asarray(20.0 / np.log(10.0) * error.real)


def responses(runs: int, first: int) -> None:
    """Coverage inside the stated band, bias of the gain from 8 to 80 rad/s in it, the band's edges."""
    swept = (2.0 * np.pi * SWEPT_HZ[0], 2.0 * np.pi * SWEPT_HZ[1])
    print("| disturbance | method | holds, % | below 8 rad/s | bias 8 to 80, dB | edges | outside swept |")
    for disturbance in DISTURBANCES:
        loop = Loop(disturbance)
        for name in ("through chirp", "direct"):
            hits = 0
            total = 0
            low_hits = 0
            low_total = 0
            outside = 0
            gains = []
            edges = []
            for seed in range(first, first + (max(runs // 10, 1) if name == "direct" else runs)):
                data = loop.flown(seed)
                if name == "direct":
                    measured = measure_response(direct(data))
                else:
                    measured = measure_response(data, reference=["chirp"])
                band = measured.band()
                if band is None:
                    continue
                edges.append(band)
                outside += not (swept[0] <= band[0] and band[1] <= swept[1])
                h, n, _ = held(measured, *band)
                hits = hits + h
                total = total + n
                h, n, _ = held(measured, band[0], min(8.0, band[1]))
                low_hits = low_hits + h
                low_total = low_total + n
                gains.append(np.median(held(measured, max(8.0, band[0]), min(80.0, band[1]))[2]))
            table = np.array(edges)
            shares = f"{100 * hits / max(total, 1):.1f} | {100 * low_hits / max(low_total, 1):.1f}"
            ends = f"{table[:, 0].min():.2f}, {table[:, 1].max():.1f} | {outside} of {len(edges)}"
            print(f"| {disturbance} | {name} | {shares} | {np.mean(gains):+.2f} | {ends} |", flush=True)


def poles(runs: int, first: int) -> None:
    """Error of the pole at 33.3 rad/s and of the dead time by TF, default settings."""
    print(
        "| disturbance | method | median error of the pole, % | pole, rad/s | dead time, ms | poles found |"
    )
    for disturbance in DISTURBANCES:
        for name in ("TF through chirp", "TF direct"):
            misses = []
            found = []
            dead = []
            counts = []
            for seed in range(first, first + (max(runs // 10, 1) if name == "TF direct" else runs)):
                data = Loop(disturbance).flown(seed)
                try:
                    if name == "TF direct":
                        transfer = TF().fit(direct(data)).transfer()
                    else:
                        transfer = TF(reference=["chirp"]).fit(data).transfer()
                except FlysidError as error:
                    print(seed, error)
                    continue
                near = nearest(transfer, 33.3)
                misses.append(abs(near - 33.3) / 33.3)
                found.append(near)
                dead.append(1e3 * transfer.dead_time_s)
                counts.append(len(transfer.poles))
            print(
                f"| {disturbance} | {name} | {100 * np.median(misses):.1f} | {np.median(found):.1f} "
                f"| {np.median(dead):.1f} | {sorted(set(counts))} |",
                flush=True,
            )


def nearest(transfer: ContinuousTransfer, size: float) -> float:
    """Size of the pole that is nearest to -size."""
    return (
        float(np.abs(transfer.poles[np.argmin(np.abs(transfer.poles + size))]))
        if len(transfer.poles)
        else 0.0
    )


def instruments(runs: int, first: int) -> None:
    """IV with defaults at three rates."""
    print("| rate, Hz | disturbance | median error of the pole, % | poles found (median) | failed |")
    for rate in (50.0, 100.0, 400.0):
        for disturbance in (0.1, 0.2):
            misses = []
            counts = []
            failed = 0
            for seed in range(first, first + runs):
                data = Loop(disturbance, rate).flown(seed)
                try:
                    transfer = continuous(IV(reference=["chirp"]).fit(data))
                except FlysidError as error:
                    failed += 1
                    print(f"seed {seed}: {error}")
                    continue
                misses.append(abs(nearest(transfer, 33.3) - 33.3) / 33.3)
                counts.append(len(transfer.poles))
            print(
                f"| {rate:g} | {disturbance} | {100 * np.median(misses):.1f} "
                f"| {np.bincount(counts).tolist()} | {failed} |",
                flush=True,
            )


WORK = {"response": responses, "poles": poles, "iv": instruments}

if __name__ == "__main__":
    chosen = sys.argv[1] if len(sys.argv) > 1 else "all"
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 20
    seed_0 = int(sys.argv[3]) if len(sys.argv) > 3 else 1000
    for word, work in WORK.items():
        if chosen in (word, "all"):
            work(count, seed_0)
