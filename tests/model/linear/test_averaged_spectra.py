"""Averaged spectra against the textbook, computed window by window and frequency by frequency."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.signal.windows import dpss

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.model.frequency.response import MeasuredResponse, measure_response
from flysid.model.polynomials import ComplexArray

DT = 0.02
POINTS = 9
Frames = Sequence[FloatArray]
"""(length, signals) each, under its window."""


def records(*rows: int) -> list[FloatArray]:
    """(N, 3) two inputs that are alike in part, and an output with noise."""
    rng = np.random.default_rng(8)
    found = []
    for n in rows:
        u = rng.normal(size=(n, 2)) @ np.array([[1.0, 0.4], [0.0, 0.8]])
        y = lfilter([0.0, 0.3], [1.0, -0.7], u[:, 0]) - 0.5 * u[:, 1] + 0.3 * rng.normal(size=n)
        found.append(np.column_stack([u, y]))
    return found


def measured(of: Sequence[FloatArray], method: str) -> MeasuredResponse:
    data = Dataset.from_arrays([r[:, :2] for r in of], [r[:, 2:] for r in of], DT)
    return measure_response(data, points=POINTS, method=method)  # type: ignore[arg-type]


def spectra(frames: Frames, length: int, omega: FloatArray) -> ComplexArray:
    """(F, 3, 3) mean of conj(X_i) X_j, from transforms at the bins of a power of two, and a line between."""
    size = 2 ** int(np.ceil(np.log2(2 * length)))
    bins = 2.0 * np.pi * np.arange(size // 2 + 1) / (size * DT)
    cross = np.zeros((len(bins), 3, 3), dtype=np.complex128)
    for frame in frames:
        turn = np.exp(-1j * np.outer(bins * DT, np.arange(len(frame))))
        x = turn @ frame
        cross += np.conj(x)[:, :, None] * x[:, None, :] / len(frames)
    whole = np.empty((len(omega), 3, 3), dtype=np.complex128)
    for i, j in product(range(3), repeat=2):
        whole[:, i, j] = np.interp(omega, bins, cross[:, i, j].real)
        whole[:, i, j] += 1j * np.interp(omega, bins, cross[:, i, j].imag)
    return whole


def hann(length: int) -> FloatArray:
    return np.sin(np.pi * np.arange(1, length + 1) / (length + 1)) ** 2


def welch(of: Sequence[FloatArray], length: int) -> tuple[Frames, float]:
    """Windows a quarter apart, and how many without overlap would be as good (Welch, 1967)."""
    window = hann(length) / np.sqrt((hann(length) ** 2).sum())
    hop = length // 4
    frames = []
    shared = 0.0
    for r in of:
        starts = range(0, len(r) - length + 1, hop)
        pieces = [r[s : s + length] for s in starts]
        frames += [(p - p.mean(axis=0)) * window[:, None] for p in pieces]
        for a, b in product(starts, repeat=2):
            apart = abs(a - b)
            shared += float(window[apart:] @ window[: max(length - apart, 0)]) ** 2 if apart < length else 0.0
    return frames, len(frames) ** 2 / shared


def check(found: MeasuredResponse, cross: ComplexArray, averages: FloatArray) -> None:
    """Responses, partial coherences (Bendat and Piersol, 2010, 7.3) and errors of two inputs."""
    uu, uy = cross[:, :2, :2], cross[:, :2, 2]
    response = np.linalg.solve(uu, uy[:, :, None])[:, :, 0]
    assert found.response == pytest.approx(response, rel=1e-6)
    coherence = np.empty((len(averages), 2))
    for own, other in ((0, 1), (1, 0)):
        left = cross - cross[:, :, [other]] * cross[:, [other], :] / cross[:, [other], :][:, :, [other]]
        coherence[:, own] = (np.abs(left[:, own, 2]) ** 2 / (left[:, own, own] * left[:, 2, 2])).real
    assert found.coherence == pytest.approx(coherence, rel=1e-6)
    assert found.averages == pytest.approx(np.outer(averages - 1.0, [1.0, 1.0]), rel=1e-6)
    assert found.freedom == pytest.approx(2.0 * (averages - 2.0), rel=1e-6)
    error = np.sqrt((1.0 - coherence) / (2.0 * coherence * (averages - 1.0)[:, None]))
    assert found.error == pytest.approx(error, rel=1e-6)


def test_windows_of_one_length_are_those_of_welch() -> None:
    """A quarter of 250 samples; half of that would be below 32."""
    of = records(150, 100)
    found = measured(of, "welch")
    length = 62
    assert found.omega == pytest.approx(np.geomspace(4.0 * np.pi / (length * DT), 0.8 * np.pi / DT, POINTS))
    frames, averages = welch(of, length)
    check(found, spectra(frames, length, found.omega), np.full(POINTS, averages))
    turn = np.exp(1j * DT * np.subtract.outer(found.omega, found.omega)[:, :, None] * np.arange(length))
    shape = np.abs(turn @ hann(length) ** 2 / (hann(length) ** 2).sum()) ** 2
    assert found.correlation[0] == pytest.approx(shape, abs=0.03)
    assert found.correlation[1].tolist() == found.correlation[0].tolist()


def test_windows_of_several_lengths_count_by_the_fourth_power_of_their_errors() -> None:
    of = records(600, 400)
    found = measured(of, "welch")
    lengths = (250, 125, 62)
    parts = []
    weights = []
    counts = []
    for length in lengths:
        frames, averages = welch(of, length)
        cross = spectra(frames, length, found.omega)
        response = np.linalg.solve(cross[:, :2, :2], cross[:, :2, 2:])[:, :, 0]
        both = (np.einsum("fi,fi->f", np.conj(response), cross[:, :2, 2]) / cross[:, 2, 2]).real
        known = found.omega * length * DT >= 4.0 * np.pi * (1.0 - 1e-9)
        parts.append(cross)
        weights.append(np.where(known, ((1.0 - both) / (2.0 * averages * both)) ** -2.0, 0.0))
        counts.append(averages)
    share = np.array(weights) / np.sum(weights, axis=0)
    assert ((share > 0.0).sum(axis=0) == [1, 1, 2, 3, 3, 3, 3, 3, 3]).all()
    check(found, np.einsum("lf,lfij->fij", share, np.array(parts)), share.T @ np.array(counts))


def test_seven_windows_of_slepian_are_as_many_averages() -> None:
    of = records(90, 60, 20)
    found = measured(of, "multitaper")
    assert found.omega[0] == pytest.approx(4.0 * np.pi / (45 * DT))
    mean = np.concatenate(of).mean(axis=0)
    frames = [
        window[:, None] * (r - mean - (r - mean).mean(axis=0))
        for r in of[:2]
        for window in dpss(len(r), 4, 7)
    ]
    check(found, spectra(frames, 90, found.omega), np.full(POINTS, 14.0))


def test_windows_need_32_samples_and_two_averages() -> None:
    measured(records(128), "welch")
    with pytest.raises(DataError, match="too few"):
        measured(records(127), "welch")
    measured(records(32), "multitaper")
    with pytest.raises(DataError, match="too short"):
        measured(records(31, 31), "multitaper")
