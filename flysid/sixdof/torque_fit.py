"""Torques of motors, their lag and delay: regression of angular acceleration in a band of frequencies.

A controller answers what turns the vehicle, so that a fit to the free run finds the controller's inverse:
signs turned round, a delay below zero. Within a band the motors lead. Below it disturbances and the
controller's answer to them rule; above it what sampling and the link have smoothed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from flysid.errors import DataError
from flysid.sixdof import layout, rotations
from flysid.sixdof.actuators import CHAIN, interval_means, shares
from flysid.sixdof.descent import Block, Found, descend
from flysid.sixdof.layout import DAMPING, EFFECTS, INERTIA, LEAN
from flysid.sixdof.record import Record
from flysid.spectra.stages import band_pass, run_both_ways
from flysid.stretch import FloatArray

BAND_HZ = (0.4, 12.0)
BLOCK_S = 3.0
"""Disturbances of blocks are taken for independent: longer than gusts and loops remember."""
STARTS = ((0.02, 0.06), (0.0, 0.02))
"""Lags and delays, s, that the search starts from."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A whole stretch of a flight, ready for regression.

    Attributes
    ----------
    commands, log_voltage : of the record from its beginning to the stretch's end, so that motors are settled.
    first : where the stretch begins in them.
    rates : (n, 3) rad/s; air : (n, 3) velocity in body axes, zeros where it is not measured.
    """

    flight: str
    dt_s: float
    commands: FloatArray
    log_voltage: FloatArray
    first: int
    rates: FloatArray
    air: FloatArray

    def halves(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Thrust shares of the stretch at half samples, and their derivatives."""
        found, by = shares(self.commands, self.log_voltage, self.dt_s, theta)
        return found[2 * self.first :], by[:, 2 * self.first :]


def log_voltage_of(record: Record, reference: float) -> FloatArray:
    """(N,) logarithm of the voltage over the reference's; zeros where none is measured."""
    if record.voltage is None:
        return np.zeros(len(record))
    return np.asarray(np.log(record.voltage / reference))


def pieces_of(records: Sequence[Record], reference_v: float, lead_s: float = 1.0) -> list[Piece]:
    """Every whole stretch in the air, with the commands of the second before it."""
    found = []
    for record in records:
        log_voltage = log_voltage_of(record, reference_v)
        lead = round(lead_s / record.dt_s)
        for first, last in record.stretches:
            begin = max(first - lead, 0)
            air = np.zeros((last - first, 3))
            if record.velocity is not None and record.attitude is not None:
                air = rotations.to_body(record.attitude[first:last], record.velocity[first:last])
            found.append(
                Piece(
                    record.flight,
                    record.dt_s,
                    record.commands[begin:last],
                    log_voltage[begin:last],
                    first - begin,
                    record.gyro[first:last],
                    air,
                )
            )
    return found


def band_of(dt_s: float, band_hz: tuple[float, float] = BAND_HZ) -> list[FloatArray]:
    """Sections of the zero-phase filter; its upper edge stays below a quarter of the sampling rate."""
    high = min(band_hz[1], 0.25 / dt_s)
    if high <= band_hz[0]:
        raise DataError(
            f"samples every {dt_s:g} s are too slow for torques", hint="log motors and gyro at 50 Hz or more"
        )
    return band_pass((band_hz[0], high), 1.0 / dt_s)


def fit_torques(
    pieces: Sequence[Piece],
    theta: FloatArray,
    *,
    has_air: bool,
    band_hz: tuple[float, float] = BAND_HZ,
    settled: bool = False,
) -> Found:
    """Effects of motors, their lag, delay, damping and what speed turns, with their covariance.

    Parameters
    ----------
    theta : start; curve, power and inertia ratios are held.
    has_air : velocities are known.
    settled : lag and delay of `theta` are a good start, so that no grid is searched.
    """
    motors = pieces[0].commands.shape[1]
    sections = band_of(pieces[0].dt_s, band_hz)
    free = [layout.LAG, layout.DELAY, *range(DAMPING, DAMPING + 3), *range(EFFECTS, layout.count(motors))]
    free += list(range(LEAN, LEAN + 2)) if has_air else []
    limits = layout.limits(motors)
    measured = [filter_columns(sections, np.diff(p.rates, axis=0) / p.dt_s) for p in pieces]
    scale = np.sqrt(np.mean(np.concatenate(measured) ** 2, axis=0))
    scale[scale <= 0.0] = 1.0

    def blocks_at(theta: FloatArray) -> list[Block]:
        return [
            b for p, y in zip(pieces, measured, strict=True) for b in _blocks(p, y, scale, sections, theta)
        ]

    starts = [theta] if settled else []
    if not settled:
        for lag, delay in product(*STARTS):
            start = theta.copy()
            start[[layout.LAG, layout.DELAY]] = lag, delay
            linear = [i for i in free if i not in (layout.LAG, layout.DELAY)]
            starts.append(descend(blocks_at, start, linear, limits, steps=2).theta)
        starts.sort(key=lambda s: sum(float(r @ r) for r, _ in blocks_at(s)))
    first = descend(blocks_at, starts[0], free, limits)
    left = _left_by_axis(blocks_at(first.theta))
    left[left <= 0.0] = left.max()  # an axis about which nothing turned
    scale *= left / left.mean()  # axes count by what they leave, so that a noisy one pulls no other
    return descend(blocks_at, first.theta, free, limits)


def odds_of_none(
    pieces: Sequence[Piece],
    theta: FloatArray,
    band_hz: tuple[float, float] = BAND_HZ,
    *,
    shifts: int = 400,
    seed: int = 0,
) -> float:
    """Chance that motors explain so much of angular accelerations where nothing follows them.

    Commands that are shifted in time explain nothing, and are as slow as the true ones. Of the three axes
    that counts which is explained best.

    Parameters
    ----------
    shifts : how many are tried; the least chance is 3 over their number.
    """
    sections = band_of(pieces[0].dt_s, band_hz)
    turned = np.concatenate([filter_columns(sections, np.diff(p.rates, axis=0) / p.dt_s) for p in pieces])
    means = [interval_means(p.halves(theta)[0]) for p in pieces]
    share = np.concatenate([filter_columns(sections, x - x.mean(axis=0)) for x in means])
    inverse = np.linalg.pinv(share.T @ share, hermitian=True)

    def explained(shift: int) -> FloatArray:
        by = share.T @ np.roll(turned, shift, axis=0)
        return np.asarray((by * (inverse @ by)).sum(axis=0))

    least = min(round(BLOCK_S / pieces[0].dt_s), len(turned) // 3)
    tried = np.random.default_rng(seed).integers(least, len(turned) - least, shifts)
    more = np.array([explained(int(shift)) for shift in tried]) >= explained(0)
    return min(1.0, 3.0 * (1.0 + float(more.sum(axis=0).min())) / (1.0 + shifts))


def _left_by_axis(blocks: Sequence[Block]) -> FloatArray:
    """(3,) root mean squares of residuals: a block holds its axes one after another."""
    left = [np.mean(residuals.reshape(3, -1) ** 2, axis=1) for residuals, _ in blocks]
    return np.asarray(np.sqrt(np.mean(left, axis=0)))


def filter_columns(sections: Sequence[FloatArray], x: FloatArray) -> FloatArray:
    """(n, ...) every column through a zero-phase filter, see `band_of`."""
    columns = [run_both_ways(sections, column) for column in x.reshape(len(x), -1).T]
    return np.stack(columns, axis=1).reshape(x.shape)


def _basis(piece: Piece, theta: FloatArray) -> FloatArray:
    """(n - 1, C) what angular accelerations are sums of: shares, derivatives, rates, speeds, couples."""
    halves, by = piece.halves(theta)
    share = interval_means(halves)
    spin = np.sqrt(share).sum(axis=1, keepdims=True)
    rate = 0.5 * (piece.rates[1:] + piece.rates[:-1])
    air = 0.5 * (piece.air[1:] + piece.air[:-1])
    pitch, yaw = theta[INERTIA : INERTIA + 2]
    couple = np.array([pitch - yaw, (yaw - 1.0) / pitch, (1.0 - pitch) / yaw])
    turning = couple * np.roll(rate, -1, axis=1) * np.roll(rate, -2, axis=1)
    return np.hstack([share, *interval_means(by), spin * rate, spin * air[:, [1, 0]], turning])


def _told(basis: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n - 1, 3) angular accelerations without trim, and (n - 1, 3, P) their derivatives."""
    effect = layout.effects(theta)
    motors = effect.shape[1]
    share = basis[:, :motors]
    rest = motors * (1 + len(CHAIN))
    rate, leaning, turning = basis[:, rest : rest + 3], basis[:, rest + 3 : rest + 5], basis[:, rest + 5 :]
    slopes = np.zeros((len(basis), 3, len(theta)))
    for k in range(3):
        slopes[:, k, EFFECTS + k * motors : EFFECTS + (k + 1) * motors] = share
        slopes[:, k, DAMPING + k] = -rate[:, k]
        for place, column in enumerate(CHAIN, start=1):
            slopes[:, k, column] = basis[:, place * motors : (place + 1) * motors] @ effect[k]
    slopes[:, 0, LEAN] = leaning[:, 0]
    slopes[:, 1, LEAN + 1] = leaning[:, 1]
    told = share @ effect.T - theta[DAMPING : DAMPING + 3] * rate + turning
    told[:, :2] += theta[LEAN : LEAN + 2] * leaning
    return told, slopes


def _blocks(
    piece: Piece, measured: FloatArray, scale: FloatArray, sections: Sequence[FloatArray], theta: FloatArray
) -> list[Block]:
    told, slopes = _told(filter_columns(sections, _basis(piece, theta)), theta)
    return cut_into_blocks((measured - told) / scale, slopes / scale[:, None], round(BLOCK_S / piece.dt_s))


def cut_into_blocks(left: FloatArray, by: FloatArray, length: int) -> list[Block]:
    """Residuals (n, k) and slopes (n, k, P) as blocks of rows, columns one after another."""
    count = max(len(left) // length, 1)
    parts = np.array_split(np.arange(len(left)), count)
    return [(left[r].T.ravel(), by[r].transpose(1, 0, 2).reshape(-1, by.shape[2])) for r in parts]


def trims(pieces: Sequence[Piece], theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) mean angular acceleration that nothing else explains, and its standard error by blocks of time."""
    means = []
    for piece in pieces:
        left = np.diff(piece.rates, axis=0) / piece.dt_s - _told(_basis(piece, theta), theta)[0]
        count = max(len(left) // round(BLOCK_S / piece.dt_s), 1)
        means += [part.mean(axis=0) for part in np.array_split(left, count)]
    every = np.array(means)
    spread = every.std(axis=0, ddof=1) if len(every) > 1 else np.full(3, np.nan)
    return every.mean(axis=0), spread / np.sqrt(len(every))
