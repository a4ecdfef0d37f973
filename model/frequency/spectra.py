"""Frequency response by averaged spectra: windows of several lengths combined, or multitaper.

Composite windows after Tischler & Remple (2012, Aircraft and Rotorcraft System Identification, ch. 10): long
windows resolve low frequencies, short ones average more; every frequency takes the spectra of each length
with the weight eps^-4. Inputs are conditioned on each other (Bendat & Piersol, 2010, 7.3).

Memory: one batch of windows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from flysid.dataset import FloatArray
from flysid.errors import DataError
from flysid.model.frequency.spectral import Spectral, grid
from flysid.model.polynomials import ComplexArray

CYCLES = 2.0
"""A window tells frequencies apart that pass through it at least twice."""
SHORTEST = 32
SHARE = 4
"""The longest window is at most this part of the recording."""
OVERLAP = 4
TAPERS = 7


def welch_response(
    records: Sequence[FloatArray], dt_s: float, points: int, band: tuple[float, float] | None
) -> Spectral:
    """Composite of Hann windows (Welch, 1967); records are (N, n_u + 1), the output last.

    Raises DataError: too short for two windows. Raises UsageError: the band holds none of the frequencies.
    """
    lengths = _lengths(records)
    if not lengths:
        raise DataError(
            f"{sum(map(len, records))} samples are too few for a frequency response",
            hint=f"bring a segment of at least {SHORTEST} samples and {SHARE} times as many in all",
        )
    omega = grid(_lowest(lengths[0], dt_s), dt_s, points, band)
    pieces = [_Spectra.of(records, n, dt_s, omega) for n in lengths]
    spectra, averages, window_s = _combine([p for p in pieces if p is not None], omega)
    return _condition(spectra, averages, window_s, omega)


def multitaper_response(
    records: Sequence[FloatArray], dt_s: float, points: int, band: tuple[float, float] | None
) -> Spectral:
    """Whole segments under seven Slepian windows (Thomson, 1982, Proc. IEEE 70).

    Raises DataError: every segment is too short. Raises UsageError: the band holds none of the frequencies.
    """
    longest = max(map(len, records))
    if longest < SHORTEST:
        raise DataError(
            f"segments of at most {longest} samples are too short for a frequency response",
            hint=f"bring a segment of at least {SHORTEST} samples",
        )
    omega = grid(_lowest(max(longest // 2, 1), dt_s), dt_s, points, band)
    piece = _Spectra.of(records, longest, dt_s, omega, tapered=True)
    spectra, averages, window_s = _combine([piece] if piece else [], omega)
    return _condition(spectra, averages, window_s, omega)


def _lowest(longest: int, dt_s: float) -> float:
    """The lowest frequency that passes often enough through the longest window, rad/s."""
    return 2.0 * np.pi * CYCLES / (longest * dt_s)


def _lengths(records: Sequence[FloatArray], *, most: int = 5) -> list[int]:
    """Window lengths in samples, longest first, each half of the one before."""
    total = sum(map(len, records))
    longest = max(map(len, records))
    first = min(longest, total // SHARE)
    return [first >> k for k in range(most) if first >> k >= SHORTEST]


@dataclass(frozen=True, eq=False)
class _Spectra:
    """Cross-spectra (F, n, n) of one window length, on the common frequencies; n signals, output last."""

    matrix: ComplexArray
    averages: float
    window_s: float

    @classmethod
    def of(
        cls,
        records: Sequence[FloatArray],
        length: int,
        dt_s: float,
        omega: FloatArray,
        tapered: bool = False,
    ) -> _Spectra | None:
        """None where fewer than two independent windows fit."""
        own = _taper(records) if tapered else _hann_frames(records, length)
        size = 1 << (2 * length - 1).bit_length()
        n = records[0].shape[1]
        total = np.zeros((size // 2 + 1, n, n), dtype=np.complex128)
        count = 0.0
        for frames in own:
            f = np.fft.rfft(frames, size, axis=1)
            total += np.einsum("kfi,kfj->fij", np.conj(f), f)
            count += len(frames)
        averages = count if tapered else _independent(records, length)
        if averages < 2.0:
            return None
        bins = 2.0 * np.pi * np.fft.rfftfreq(size, dt_s)
        flat = (total / count).reshape(len(bins), -1)
        columns = [np.interp(omega, bins, c.real) + 1j * np.interp(omega, bins, c.imag) for c in flat.T]
        window_s = length * dt_s * (2.0 / (TAPERS + 1) if tapered else 1.0)
        return cls(np.stack(columns, axis=1).reshape(len(omega), n, n), averages, window_s)


def _hann_frames(
    records: Sequence[FloatArray], length: int, *, batch_samples: int = 1 << 19
) -> Iterator[FloatArray]:
    """(K, length, n) windowed pieces, their means taken out, a batch at a time."""
    taper = np.hanning(length + 2)[1:-1]
    taper = taper / np.sqrt(float(taper @ taper))
    hop = max(length // OVERLAP, 1)
    per_batch = max(batch_samples // length, 1)
    for record in records:
        starts = range(0, len(record) - length + 1, hop)
        for at in range(0, len(starts), per_batch):
            batch = np.stack([record[s : s + length] for s in starts[at : at + per_batch]])
            yield (batch - batch.mean(axis=1, keepdims=True)) * taper[:, None]


def _taper(records: Sequence[FloatArray]) -> Iterator[FloatArray]:
    """(tapers, N, n) every whole segment under each of the Slepian windows."""
    from scipy.signal.windows import dpss

    for record in records:
        if len(record) >= SHORTEST:
            tapers = dpss(len(record), (TAPERS + 1) / 2, TAPERS)
            yield tapers[:, :, None] * (record - record.mean(axis=0))[None]


def _independent(records: Sequence[FloatArray], length: int) -> float:
    """Windows that would be as good without overlap (Welch, 1967): K^2 / sum of squared correlations."""
    taper = np.hanning(length + 2)[1:-1]
    hop = max(length // OVERLAP, 1)
    energy = float(taper @ taper)
    rho2 = [(float(taper[j * hop :] @ taper[: length - j * hop]) / energy) ** 2 for j in range(1, OVERLAP)]
    frames = 0
    shared = 0.0
    for record in records:
        k = max((len(record) - length) // hop + 1, 0)
        frames += k
        shared += k + 2.0 * sum(max(k - j, 0) * r for j, r in enumerate(rho2, start=1))
    return frames**2 / shared if shared else 0.0


def _combine(pieces: Sequence[_Spectra], omega: FloatArray) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Spectra, averages and window of every frequency, each length weighted by its error to the power -4.

    A length speaks only where at least two cycles fit into it.
    """
    if not pieces:
        raise DataError(
            "fewer than two windows fit into these segments: no coherence can be told",
            hint="bring longer segments or more of them",
        )
    weights = np.zeros((len(pieces), len(omega)))
    for i, piece in enumerate(pieces):
        g2 = np.clip(_multiple(piece.matrix), 1e-6, 1.0 - 1e-9)
        error = np.sqrt((1.0 - g2) / (2.0 * piece.averages * g2))
        told = omega * piece.window_s >= 2.0 * np.pi * CYCLES * (1.0 - 1e-9)
        weights[i] = np.where(told, error**-4.0, 0.0)
    alone = weights.sum(axis=0) == 0.0
    weights[0, alone] = 1.0
    weights = weights / weights.sum(axis=0)
    spectra = sum(w[:, None, None] * p.matrix for w, p in zip(weights, pieces, strict=True))
    averages = weights.T @ np.array([p.averages for p in pieces])
    window_s = weights.T @ np.array([p.window_s for p in pieces])
    return np.asarray(spectra), np.asarray(averages), np.asarray(window_s)


def _multiple(matrix: ComplexArray) -> FloatArray:
    """(F,) multiple coherence of spectra whose last signal is the output."""
    uu = matrix[:, :-1, :-1]
    uy = matrix[:, :-1, -1]
    yy = matrix[:, -1, -1].real
    h = _solve(uu, uy)
    explained = np.einsum("fi,fi->f", np.conj(h), uy).real
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(yy > 0.0, np.clip(explained / yy, 0.0, 1.0), 0.0))


def _solve(uu: ComplexArray, uy: ComplexArray) -> ComplexArray:
    """H of S_uu H = S_uy, the shortest where inputs cannot be told apart."""
    return np.asarray(np.einsum("fij,fj->fi", np.linalg.pinv(uu, rcond=1e-10, hermitian=True), uy))


def _condition(
    spectra: ComplexArray, averages: FloatArray, window_s: FloatArray, omega: FloatArray
) -> Spectral:
    """Responses and partial coherences: S_uu H = S_uy; the power of input j that the others do not bring is
    1 / (S_uu^-1)_jj (Bendat & Piersol, 2010, 7.3)."""
    uu = spectra[:, :-1, :-1]
    uy = spectra[:, :-1, -1]
    yy = spectra[:, -1, -1].real
    h = _solve(uu, uy)
    left = np.maximum(yy - np.einsum("fi,fi->f", np.conj(h), uy).real, 0.0)
    inverse = np.linalg.pinv(uu, rcond=1e-10, hermitian=True)
    own = 1.0 / np.maximum(np.einsum("fii->fi", inverse).real, np.finfo(float).tiny)
    brought = np.abs(h) ** 2 * own
    with np.errstate(invalid="ignore", divide="ignore"):
        coherence = np.where(brought > 0.0, brought / (brought + left[:, None]), 0.0)
    n_u = h.shape[1]
    free = np.maximum(averages - n_u + 1, 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.sqrt((1.0 - coherence) / (coherence * 2.0 * free[:, None]))
    kernel = _kernel(omega, window_s)
    return Spectral(
        omega=omega,
        response=h,
        coherence=coherence,
        error=error,
        averages=np.repeat(free[:, None], n_u, axis=1),
        freedom=np.maximum(2.0 * (averages - n_u), 1.0),
        correlation=np.repeat(kernel[None], n_u, axis=0),
    )


def _kernel(omega: FloatArray, window_s: FloatArray) -> FloatArray:
    """(F, F) correlation between frequencies: the squared transform of the squared Hann window."""
    bins = np.abs(omega[:, None] - omega) * np.sqrt(np.outer(window_s, window_s)) / (2.0 * np.pi)
    shape = 3.0 * np.sinc(bins) + 2.0 * (np.sinc(bins - 1) + np.sinc(bins + 1))
    shape += 0.5 * (np.sinc(bins - 2) + np.sinc(bins + 2))
    return np.asarray((shape / 3.0) ** 2)
