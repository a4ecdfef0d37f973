"""A loop measured in flight: what the setpoint moves, in the controller's output and in the vehicle.

In a closed loop the ratio of output and input spectra is no response of the plant: both answer disturbances.
What the setpoint r moves is free of them (joint input-output; Pintelon & Schoukens, 2012, 2.7),

    G = S_ry / S_ru,        T = S_ry / S_rr

with the controller's output u and the measured rate y. Where an angle loop makes r, disturbances come back
through it, and r is no longer free of them; the command to that loop, z, is, and stands for r:
G = S_zy / S_zu, T = S_zy / S_zr (instrumental variables; Söderström & Stoica, 1989, 10.5). The scatter is
found by resampling stretches of windows, whole flights where there are several.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.showing import counted

ComplexArray = npt.NDArray[np.complex128]
OVERLAP = 0.5
TOGETHER = 4  # windows to a block: stretches this long hardly know of each other
DRAWS = 200
LEAST_BLOCKS = 6
FLIGHTS_TO_RESAMPLE = 4


@dataclass(frozen=True, eq=False)
class StickRecord:
    """One flight of a loop on an even grid, in pieces without gaps.

    `rate_hz`: samples a second.
    `pieces`: (3, N) setpoint, controller's output, measured rate; (4, N) where the last, what an outer loop
        is asked for, stands for the setpoint as what is free of disturbances.
    """

    name: str
    rate_hz: float
    pieces: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class Loop:
    """Spectra of one or several flights of a loop, and what to resample.

    `f`: (F,) Hz.
    `blocks`: per flight (B, 3, 3, F) sums of conj(W_i) X_j over the windows of a block; X setpoint, output,
        rate, and W the same or with what is asked from outside in the setpoint's place.
    """

    f: FloatArray
    blocks: tuple[ComplexArray, ...]

    @classmethod
    def of(cls, records: Sequence[StickRecord], window_s: float = 2.0, *, highest_hz: float = 250.0) -> Loop:
        """Windows of `window_s`, under a Hann window; no hand moves a vehicle above `highest_hz`.

        Raises DataError: fewer than `LEAST_BLOCKS` blocks in all, no stick movement, or flights of different
        rates.
        """
        rate = records[0].rate_hz
        if any(abs(r.rate_hz - rate) > 1e-9 * rate for r in records):
            raise DataError("the flights are sampled at different rates", hint="judge one flight at a time")
        size = round(window_s * rate)
        if not any(np.ptp(piece[0]) for record in records for piece in record.pieces):
            raise DataError(
                "the sticks never move, so the loop cannot be identified",
                hint="fly quick stick movements on this axis, a minute of them, in calm air",
            )
        lines = 1 + min(size // 2, round(window_s * highest_hz))
        blocks = tuple(_blocks(record, size, lines) for record in records)
        if sum(len(b) for b in blocks) < LEAST_BLOCKS:
            block_s = window_s * (1.0 + (TOGETHER - 1) * (1.0 - OVERLAP))
            raise DataError(
                f"the flight is too short to identify a loop: "
                f"{counted(sum(len(b) for b in blocks), 'block')} of "
                f"{block_s:g} s without gaps, {LEAST_BLOCKS} are needed",
                hint="fly half a minute with stick movements",
            )
        return cls(
            np.asarray(np.fft.rfftfreq(size, 1.0 / rate)[:lines], dtype=np.float64),
            tuple(b for b in blocks if len(b)),
        )

    @cached_property
    def mean(self) -> ComplexArray:
        """(3, 3, F) over everything."""
        return np.asarray(sum(b.sum(axis=0) for b in self.blocks))

    @cached_property
    def draws(self) -> ComplexArray:
        """(DRAWS, 1, 3, F) resampled: flights first, where there are at least four, then blocks of each.

        Only what the setpoint moves: the rest of the sums would take twice as much memory again.
        """
        rng = np.random.default_rng(0)
        flights = len(self.blocks)
        often = np.ones((DRAWS, flights))  # how often a flight is drawn
        if flights >= FLIGHTS_TO_RESAMPLE:
            often = rng.multinomial(flights, np.full(flights, 1.0 / flights), DRAWS).astype(np.float64)
        moved = [b[:, :1] for b in self.blocks]
        total = np.zeros((DRAWS, moved[0][0].size), dtype=np.complex128)
        for i, b in enumerate(moved):
            counts = rng.multinomial(len(b), np.full(len(b), 1.0 / len(b)), DRAWS) * often[:, [i]]
            total += counts @ b.reshape(len(b), -1)
        return total.reshape(DRAWS, *moved[0].shape[1:])

    def spread(self) -> FloatArray:
        """(F,) relative standard error of the plant, or of the output's or the rate's answer to the setpoint.

        Of the plant alone it would not do: where the sticks say nothing, output and rate still agree, since
        the controller makes the one of the other, and their ratio is -1 / C with hardly any scatter.
        """
        every = (plant, closed_loop, output)
        return np.asarray(np.max([_relative(of(self.draws), of(self.mean)) for of in every], axis=0))


def _relative(draws: ComplexArray, centre: ComplexArray) -> FloatArray:
    away = np.abs(draws - centre) ** 2
    return np.asarray(np.sqrt(np.median(away, axis=0) / np.log(2.0)) / np.maximum(np.abs(centre), 1e-300))


def plant(s: ComplexArray) -> ComplexArray:
    """From the controller's output to the rate; of spectra (..., 3, 3, F)."""
    return np.asarray(s[..., 0, 2, :] / s[..., 0, 1, :])


def closed_loop(s: ComplexArray) -> ComplexArray:
    """From the setpoint to the rate."""
    return np.asarray(s[..., 0, 2, :] / s[..., 0, 0, :])


def output(s: ComplexArray) -> ComplexArray:
    """From the setpoint to the controller's output."""
    return np.asarray(s[..., 0, 1, :] / s[..., 0, 0, :])


def _blocks(record: StickRecord, size: int, lines: int) -> ComplexArray:
    """(B, 3, 3, lines) of the windows of one flight."""
    step = max(1, round(size * (1.0 - OVERLAP)))
    window = np.hanning(size)
    found = []
    for piece in record.pieces:
        steps = np.diff(piece, axis=1)
        starts = np.arange(0, steps.shape[1] - size + 1, step)
        for group in (starts[i : i + TOGETHER] for i in range(0, len(starts) - TOGETHER + 1, TOGETHER)):
            total = np.zeros((3, 3, lines), dtype=np.complex128)
            for at in group:
                cut = steps[:, at : at + size]
                X = np.fft.rfft((cut - cut.mean(axis=1, keepdims=True)) * window, axis=1)[:, :lines]
                W = X[[3, 1, 2]] if len(X) > 3 else X
                total += W.conj()[:, None] * X[None, :3]
            found.append(total)
    return np.asarray(found) if found else np.zeros((0, 3, 3, lines), dtype=np.complex128)
