"""Responses, transfer functions and instruments through a reference, in a loop whose plant is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import flysid
from bench import loop_bands
from bench.closed_loop import PLANT, SWEPT_HZ, Loop, direct, held, nearest, truth
from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.model.base import load
from flysid.model.frequency.controller_inverse import view_loop
from flysid.model.frequency.response import measure_response
from flysid.model.frequency.transfer import continuous
from flysid.model.iv import IV
from flysid.model.transfer_function import TF


@pytest.fixture(scope="module")
def flown() -> list[Dataset]:
    return [Loop(0.2, rate_hz=100.0).flown(seed) for seed in range(6)]


def test_through_the_chirp_the_plant_lies_in_the_intervals_and_the_band_in_the_sweep(
    flown: list[Dataset],
) -> None:
    hits = 0
    total = 0
    bias = []
    for data in flown:
        measured = measure_response(data, reference=["chirp"], points=40)
        band = measured.band()
        assert band is not None
        assert 2 * np.pi * SWEPT_HZ[0] < band[0] < 15.0
        assert 30.0 < band[1] < 2 * np.pi * SWEPT_HZ[1]
        good, count, errors_db = held(measured, *band)
        hits = hits + good
        total = total + count
        bias.append(np.median(errors_db))
        assert measured.reference == ("chirp",)
    assert 0.88 < hits / total <= 1.0
    assert abs(np.mean(bias)) < 0.25


def test_the_direct_response_is_the_controller_s_where_it_answers(flown: list[Dataset]) -> None:
    """What the reference is for: at 2 rad/s the direct response is 20 dB off, with a coherence near 0.9."""
    measured = measure_response(direct(flown[0]), points=40)
    at = int(np.argmin(np.abs(measured.omega - 2.0)))
    assert measured.coherence[at, 0] > 0.85
    assert abs(np.log(np.abs(measured.response[at, 0] / PLANT.at(measured.omega)[at, 0]))) > 2.0
    through = measure_response(flown[0], reference=["chirp"], points=40)
    assert (through.coherence[through.omega < 2 * np.pi * SWEPT_HZ[0] / 2] < 0.6).all()


def test_where_a_response_follows_the_controller_is_named() -> None:
    """-1 / C is 20 dB and more off the plant above the sweep; open loop has no such band."""
    data = direct(Loop(0.2).flown(3))
    measured = measure_response(data)
    view = view_loop(data, 0, measured)
    assert view is not None
    assert view.seen(measured)
    bands = view.follows(measured)
    assert any(low < 120.0 and high > 800.0 for low, high in bands)
    wrong = np.abs(np.log(np.abs(measured.response[:, 0] / truth(measured.omega, data.dt_s))))
    inside = np.any([(measured.omega >= a) & (measured.omega <= b) for a, b in bands], axis=0)
    assert wrong[inside].min() > 0.5
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(600), 10)
    y = lfilter([0.0, 0.2], [1.0, -0.8], u) + 0.1 * rng.standard_normal(6000)
    alone = Dataset.from_arrays(u, y, 0.02)
    measured = measure_response(alone)
    view = view_loop(alone, 0, measured)
    assert view is not None
    assert not view.seen(measured)
    assert view.follows(measured) == []


@pytest.mark.parametrize(("gusts", "some"), [(0.3, True), (3.0, False)])
def test_in_a_loop_a_band_is_told_where_the_response_is_the_plants(gusts: float, some: bool) -> None:
    """Weak gusts had hidden every band, strong ones none: there the coherence is that of -1 / C."""
    told = off = 0
    for seed in range(300, 305):
        data, plant = loop_bands.flown(np.random.default_rng(seed), gusts)
        measured = measure_response(data)
        view = view_loop(data, 0, measured)
        assert view is not None
        inside = measured.trusted(0, view.plants) > 0
        wrong = np.log(measured.response[:, 0] / loop_bands.plant_at(plant, measured.omega))
        told += int(inside.sum())
        off += int((inside & (np.abs(wrong) > loop_bands.OFF)).sum())
    assert (told > 100) is some
    assert off <= max(2, told // 50)


def test_two_references_tell_two_inputs_apart() -> None:
    """y = 2 z^-1 u1 - z^-2 u2, u = r - feedback of y's noise: both plants, each within its interval."""
    rng = np.random.default_rng(4)
    n = 6000
    r = rng.standard_normal((n, 2))
    v = np.convolve(rng.standard_normal(n), [1.0, 0.8, 0.5], mode="same")
    u = np.zeros((n, 2))
    y = np.zeros(n)
    for k in range(n):
        y[k] = 2.0 * u[k - 1, 0] * (k > 0) - u[k - 2, 1] * (k > 1) + v[k]
        u[k] = r[k] - [0.3 * y[k], -0.2 * y[k]]
    data = Dataset.from_arrays(np.column_stack([r, u]), y, 0.1, inputs=["r1", "r2", "u1", "u2"])
    measured = measure_response(data, reference=["r1", "r2"], points=40, band=(2.0, 25.0))
    assert [s.name for s in measured.inputs] == ["u1", "u2"]
    back = np.exp(-1j * measured.omega * 0.1)
    plants = np.stack([2.0 * back, -(back**2)], axis=1)
    error = np.log(measured.response / plants)
    width = measured.half_width()
    assert np.mean(np.abs(error.real) < width) > 0.85
    assert np.mean(np.abs(error.imag) < width) > 0.85
    assert np.median(np.abs(error)) < 0.2


def test_a_transfer_function_through_the_chirp(flown: list[Dataset], tmp_path: Path) -> None:
    found = [TF(reference=["chirp"]).fit(data) for data in flown[:3]]
    assert np.median([abs(nearest(m.transfer(), 33.3) - 33.3) for m in found]) < 0.2 * 33.3
    model = found[0]
    assert [s.name for s in model.inputs] == ["u", "chirp"]  # a model of the dataset's inputs, as any other
    assert not model.system.b[:, :, 1].any()
    assert len(model.transfers) == 1
    omega = np.array([20.0, 40.0])
    assert np.abs(np.log(model.transfer().at(omega) / PLANT.at(omega)[:, 0])).max() < 0.2
    model.save(tmp_path / "tf.json")
    again = load(tmp_path / "tf.json")
    segment = flown[0].segments[0]
    np.testing.assert_array_equal(
        again.simulate(segment.u[:200], segment.y[:20]), model.simulate(segment.u[:200], segment.y[:20])
    )


@pytest.mark.parametrize("rate_hz", [50.0, 100.0, 400.0])
def test_instruments_by_default_find_the_poles_and_no_others(rate_hz: float) -> None:
    transfer = continuous(IV(reference=["chirp"]).fit(Loop(0.1, rate_hz).flown(12)))
    assert len(transfer.poles) == 2
    assert abs(nearest(transfer, 33.3) - 33.3) < 0.2 * 33.3
    assert abs(nearest(transfer, 0.0)) < 2.0
    omega = np.array([20.0])
    assert np.abs(np.log(transfer.at(omega) / PLANT.at(omega)[:, 0])).max() < 0.3


def test_what_cannot_be_is_said(flown: list[Dataset]) -> None:
    data = flown[0]
    with pytest.raises(UsageError, match=r"no input is called 'sweep'.*one of u, chirp"):
        measure_response(data, reference=["sweep"])
    with pytest.raises(UsageError, match="every input is a reference"):
        TF(reference=["u", "chirp"]).fit(data)
    with pytest.raises(UsageError, match="cannot use a reference"):
        measure_response(data, reference=["chirp"], method="welch")
    three = Dataset.from_arrays(
        [np.column_stack([s.u, s.u[:, 0] ** 2]) for s in data.segments],
        [s.y for s in data.segments],
        data.dt_s,
        inputs=["u", "chirp", "v"],
    )
    with pytest.raises(UsageError, match=r"1 reference cannot tell 2 inputs apart \(u, v\)"):
        flysid.TF(reference=["chirp"]).fit(three)
