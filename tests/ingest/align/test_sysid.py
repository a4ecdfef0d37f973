"""Runs of ArduPilot's SYSTEMID mode: one log, several axes, each for itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import FloatArray
from flysid.errors import DataError, RecipeError
from flysid.flight import Flight
from flysid.ingest.align.align import align, dataset
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.synth.manoeuvres import chirp
from flysid.model.frequency.response import measure_response
from tests.ingest.align.test_align import flight_of, table

RECIPE = "ardupilot-sysid"
RATE_ROLL = 7
RATE_PITCH = 8
MIX_ROLL = 10
SECONDS = 40.0
DT_S = 0.01


def responded(u: FloatArray, gain: float) -> FloatArray:
    return np.asarray(lfilter([0.0, gain * 0.2], [1.0, -0.8], u))


def two_runs(first: int = RATE_ROLL, second: int = RATE_PITCH, *, with_axes: bool = True) -> Flight:
    """A chirp at the demanded roll rate (gain 1), half a minute later one at the pitch rate (gain 0.5)."""
    t = np.arange(round(SECONDS / DT_S)) * DT_S
    added = chirp(t, (0.2, 8.0), 20.0)
    rng = np.random.default_rng(0)
    quiet = rng.standard_normal((2, len(t)))
    begin = np.array([10.0, 10.0 + SECONDS + 30.0])
    t_ns = np.concatenate([((b + t) * 1e9).astype(np.int64) for b in begin])
    gx = np.concatenate([responded(added, 1.0), 0.1 * quiet[0]])
    gy = np.concatenate([0.1 * quiet[1], responded(added, 0.5)])
    both = np.tile(added, 2)
    units = {"Gx": "deg/s", "Gy": "deg/s", "Gz": "deg/s", "Az": "m/s/s"}
    tables = {"SIDD": table(t_ns, units, Targ=both, Gx=gx, Gy=gy, Gz=0.0 * gx, Az=0.0 * gx)}
    if with_axes:
        tables["SIDS"] = table(((begin - 0.01) * 1e9).astype(np.int64), Ax=np.array([first, second]))
    tables["RATE"] = table(t_ns, ROut=0.01 * both, POut=0.01 * both, YOut=0.0 * both, AOut=0.0 * both)
    return flight_of("sysid.bin", **tables)


@pytest.mark.parametrize(("channel", "gain"), [("rate_roll", 1.0), ("rate_pitch", 0.5)])
def test_each_axis_has_its_own_runs(channel: str, gain: float) -> None:
    data = dataset([two_runs()], RECIPE, channel)
    assert len(data.segments) == 1
    assert len(data) * data.dt_s == pytest.approx(SECONDS, abs=0.1)
    assert data.inputs[0].unit == "deg/s"
    measured = measure_response(data, points=30, band=(3.0, 30.0))
    back = np.exp(-1j * measured.omega * data.dt_s)
    truth = gain * 0.2 * back / (1.0 - 0.8 * back)
    assert np.abs(20.0 * np.log10(np.abs(measured.response[:, 0] / truth))).max() < 0.1


def test_an_axis_that_was_not_flown_is_said() -> None:
    with pytest.raises(DataError, match=r"SID_AXIS 9.*SIDS.Ax is 7, 8 in this log"):
        dataset([two_runs()], RECIPE, "rate_yaw")


def test_runs_whose_axis_is_not_told_are_not_pooled() -> None:
    with pytest.raises(RecipeError, match="condition 'SID_AXIS 7' needs SIDS"):
        dataset([two_runs(with_axes=False)], RECIPE, "rate_roll")


def test_a_mixer_axis_goes_through_the_chirp() -> None:
    recipe = load_recipe(RECIPE).with_references()
    data = align([two_runs(first=MIX_ROLL)], recipe, "mix_roll").dataset
    assert [s.name for s in data.inputs] == ["roll_mixer", "chirp_mixer"]
    assert [s.unit for s in data.inputs] == ["", ""]
    assert len(load_recipe(RECIPE).signals_of("mix_roll")) == 2  # for models without instruments
