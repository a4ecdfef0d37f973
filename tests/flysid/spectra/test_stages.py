"""Filters of firmwares against scipy's, and against the formulas that other firmwares write for the same."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from flysid.dataset import FloatArray
from flysid.spectra.ardupilot import HarmonicNotch, Option
from flysid.spectra.px4 import _notch
from flysid.spectra.stages import Kind, Stage, band_pass, response_of, run_both_ways, run_sections

HZ = np.linspace(1.0, 480.0, 60)
RATE = 1000.0


def px4_low_pass(cut: float, rate: float) -> tuple[FloatArray, FloatArray]:
    """LowPassFilter2p, as PX4 and ArduPilot write it."""
    ohm = np.tan(np.pi * cut / rate)
    c = 1.0 + 2.0 * np.cos(np.pi / 4.0) * ohm + ohm * ohm
    b = ohm * ohm / c
    a1 = 2.0 * (ohm * ohm - 1.0) / c
    a2 = (1.0 - 2.0 * np.cos(np.pi / 4.0) * ohm + ohm * ohm) / c
    return np.array([b, 2.0 * b, b]), np.array([1.0, a1, a2])


@pytest.mark.parametrize("cut", [5.0, 40.0, 180.0])
def test_a_biquad_is_butterworths_and_px4s(cut: float) -> None:
    own = Stage(Kind.BIQUAD, cut).response(HZ, RATE)
    for b, a in (signal.butter(2, cut, fs=RATE), px4_low_pass(cut, RATE)):
        np.testing.assert_allclose(own, signal.freqz(b, a, HZ, fs=RATE)[1], atol=1e-9)


@pytest.mark.parametrize(("centre", "q"), [(86.0, 2.0), (200.0, 0.67), (400.0, 5.0)])
def test_a_notch_is_scipys(centre: float, q: float) -> None:
    """scipy states its width at -3 dB after the frequencies are bent, Betaflight before: nearly the same."""
    sine = np.sin(2.0 * np.pi * centre / RATE)
    b, a = signal.iirnotch(centre, 2.0 * np.pi * centre / RATE / (2.0 * np.arctan(sine / (2.0 * q))), fs=RATE)
    np.testing.assert_allclose(
        Stage(Kind.NOTCH, centre, q=q).response(HZ, RATE), signal.freqz(b, a, HZ, fs=RATE)[1], atol=1e-9
    )


@pytest.mark.parametrize(
    ("low", "high", "rate"), [(0.4, 12.0, 50.0), (0.4, 12.0, 500.0), (20.0, 90.0, 250.0)]
)
def test_a_band_pass_is_butterworths(low: float, high: float, rate: float) -> None:
    hz = np.linspace(0.01, 0.49, 60) * rate
    scipys = signal.butter(2, (low, high), "band", fs=rate, output="sos")
    own = response_of(band_pass((low, high), rate), hz, rate)
    np.testing.assert_allclose(own, signal.freqz_sos(scipys, hz, fs=rate)[1], atol=1e-9)


@pytest.mark.parametrize("rows", [40, 1000])
def test_a_filter_both_ways_is_scipys(rows: int) -> None:
    """From an offset, too, on which it has settled: a band-pass on nothing."""
    x = 30.0 + np.random.default_rng(1).standard_normal(rows).cumsum()
    low = signal.butter(2, 125.0, fs=RATE, output="sos")
    band = signal.butter(2, (4.0, 60.0), "band", fs=RATE, output="sos")
    ours = (Stage(Kind.BIQUAD, 125.0).sections(RATE), band_pass((4.0, 60.0), RATE))
    for scipys, own in zip((low, band), ours, strict=True):
        np.testing.assert_allclose(run_both_ways(own, x), signal.sosfiltfilt(scipys, x), atol=1e-8)


@pytest.mark.parametrize("rows", [0, 1, 2, 9])
def test_a_log_shorter_than_the_filters_reach_keeps_its_rows(rows: int) -> None:
    """Two rows of a blackbox came back as none, and `flysid gains` ended with a traceback."""
    sections = Stage(Kind.BIQUAD, 40.0).sections(1000.0)
    np.testing.assert_allclose(run_both_ways(sections, np.full(rows, 3.0)), np.full(rows, 3.0))


def test_px4s_notch_has_the_width_that_is_stated() -> None:
    b, a = signal.iirnotch(90.0, 90.0 / 20.0, fs=RATE)
    np.testing.assert_allclose(
        _notch(90.0, 20.0, RATE).response(HZ, RATE), signal.freqz(b, a, HZ, fs=RATE)[1], atol=1e-9
    )


@pytest.mark.parametrize(("kind", "correction"), [(Kind.PT2, 1.553773974), (Kind.PT3, 1.961459177)])
def test_cascades_have_betaflights_corrections(kind: Kind, correction: float) -> None:
    order = int(kind[-1])
    once = Stage(Kind.PT1, 60.0 * correction).response(HZ, RATE)
    np.testing.assert_allclose(Stage(kind, 60.0).response(HZ, RATE), once**order, atol=1e-9)


def test_a_harmonic_notch_leaves_its_attenuation_and_two_are_as_deep_together() -> None:
    for options, count in ((Option(0), 1), (Option.DOUBLE, 2), (Option.TRIPLE, 3)):
        notch = HarmonicNotch.of(80.0, 40.0, 40.0, options, 2000.0)
        assert len(notch.spreads) == count
        at = np.array([80.0])
        gain = np.prod(
            [
                abs(Stage(Kind.NOTCH, 80.0 * (1.0 + s), notch.q, notch.left).response(at, 2000.0)[0])
                for s in notch.spreads
            ]
        )
        assert gain <= 10.0 ** (-40.0 / 20.0) * 3.0


@pytest.mark.parametrize(
    "stage",
    [
        Stage(Kind.PT1, 100.0),
        Stage(Kind.PT3, 80.0),
        Stage(Kind.BIQUAD, 90.0),
        Stage(Kind.NOTCH, 120.0, q=1.7),
        Stage(Kind.NOTCH, 60.0, q=2.0, left=0.3, weight=0.6),
    ],
)
def test_what_runs_has_the_response_that_is_stated(stage: Stage) -> None:
    impulse = np.zeros(4000)
    impulse[1] = 1.0  # the filter has settled on the first value
    out = run_sections(stage.sections(RATE), impulse)
    spectrum = np.fft.rfft(out[1:])
    hz = np.fft.rfftfreq(len(out) - 1, 1.0 / RATE)
    np.testing.assert_allclose(
        spectrum[5:900], stage.response(np.asarray(hz[5:900], dtype=np.float64), RATE), atol=1e-6
    )


def test_an_edge_that_moves_is_filtered_with_the_edge_of_each_sample() -> None:
    """Against a loop as the firmware has it: y += k (x - y)."""
    rng = np.random.default_rng(5)
    x = rng.normal(size=500)
    hz = np.linspace(100.0, 400.0, 500)
    y, expected = x[0], []
    for value, edge in zip(x, hz, strict=True):
        w = 2.0 * np.pi * edge / RATE
        y += w / (w + 1.0) * (value - y)
        expected.append(y)
    np.testing.assert_allclose(run_sections(Stage(Kind.PT1, hz).sections(RATE), x), expected, atol=1e-12)


def test_a_constant_passes_and_nothing_starts_with_a_jump() -> None:
    x = np.full(50, 7.5)
    for kind in Kind:
        np.testing.assert_allclose(run_sections(Stage(kind, 50.0).sections(RATE), x), x, atol=1e-9)
