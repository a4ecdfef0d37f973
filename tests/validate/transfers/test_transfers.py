"""From a chirp flown by the simulated vehicle to transfer functions in the terminal."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

from bench.closed_loop import SWEPT_HZ, Loop, direct
from bench.truth.records import draw_record
from bench.truth.verbs import loop_truth
from flysid.cli.tf import command
from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.files import write_atomically
from flysid.ingest.align.align import dataset
from flysid.ingest.formats.registry import read
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.synth.plants import LOOPS
from flysid.ingest.synth.rigid_body import SimulatedVehicle
from flysid.ingest.synth.synth import WRITERS, Order, flights
from flysid.ingest.synth.tuning import linearise
from flysid.model.frequency.continuous_transfer import ContinuousTransfer
from flysid.model.frequency.rational import Rational, hold_response
from flysid.model.frequency.response import measure_response
from flysid.model.frequency.sampling import sample
from flysid.model.transfer_function import TF
from flysid.validate.transfers.agreement import transfer_figures
from flysid.validate.transfers.bodeplot import draw_bode
from flysid.validate.transfers.identify import ChannelTransfers, identify_channel
from tests.command import call

CHANNELS = ("longitudinal", "lateral", "vertical")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One chirp of 100 s of each vehicle, small enough for the nonlinear one to stay near hover."""
    folder = tmp_path_factory.mktemp("chirps")
    suffix, encode = WRITERS["mcap"]
    paths = {}
    for plant in ("ardrone-linear", "ardrone"):
        (recording,) = flights(Order(plant=plant, plan="chirp", duration_s=100.0, amplitude=0.4, noise=0.002))
        paths[plant] = folder / f"{plant}{suffix}"
        write_atomically(paths[plant], encode(recording))
    return paths


def channel(path: Path, name: str) -> Dataset:
    return dataset([read(path)], "ardrone-synthetic", name)


@pytest.mark.parametrize("name", CHANNELS)
def test_the_measured_response_is_the_loop_s_own(logs: dict[str, Path], name: str) -> None:
    measured = measure_response(channel(logs["ardrone-linear"], name))
    ratio = measured.response[:, 0] / LOOPS[name].response(measured.omega)
    ratio = ratio / hold_response(measured.omega, measured.dt_s, "zero")
    trusted = measured.trusted() > 0
    assert np.count_nonzero(trusted) > 20
    inside = np.abs(np.log(np.abs(ratio[trusted]))) < measured.half_width()[trusted, 0]
    assert np.mean(inside) > 0.75
    assert np.abs(20 * np.log10(np.abs(ratio[trusted]))).max() < 1.0


@pytest.mark.parametrize("name", CHANNELS)
def test_the_nonlinear_vehicle_s_response_is_its_linearisation_s(logs: dict[str, Path], name: str) -> None:
    """Up to the link's dead time, which the linearisation leaves out and the chirp shows."""
    measured = measure_response(channel(logs["ardrone"], name))
    at = CHANNELS.index(name)
    truth = linearise(SimulatedVehicle()).response(measured.omega)[:, at, at]
    ratio = measured.response[:, 0] / truth / hold_response(measured.omega, measured.dt_s, "zero")
    trusted = (measured.trusted() > 0) & (measured.omega > 0.6)
    assert np.abs(20 * np.log10(np.abs(ratio[trusted]))).max() < 1.0
    delay_s = -np.angle(ratio[trusted]) / measured.omega[trusted]
    assert np.median(delay_s) == pytest.approx(0.04, abs=0.02)


@pytest.fixture(scope="module")
def longitudinal(logs: dict[str, Path]) -> ChannelTransfers:
    estimator = TF(poles=2, zeros=0, dead_time_s=0.0)
    return identify_channel("longitudinal", channel(logs["ardrone-linear"], "longitudinal"), estimator)


def test_the_paper_s_plant_lies_in_the_intervals(longitudinal: ChannelTransfers) -> None:
    found = longitudinal.model.transfer()
    truth = np.array([0.7995, 4.1881, 7.1429])
    values = np.append(found.numerator, found.denominator[1:])
    errors = found.errors[:3]
    assert (np.abs(values - truth) < 3.3 * errors).all()
    assert (errors < 0.02 * truth).all()
    assert not longitudinal.loops[0].closed
    assert longitudinal.fit_pct[0] is not None
    assert longitudinal.fit_pct[0] > 80


def test_what_is_printed_and_stored(longitudinal: ChannelTransfers) -> None:
    text = "\n".join(longitudinal.lines())
    for part in ("v_x / theta_in =", "s^2 + 4.", "trust it from", "coherence is above 0.6", "fit "):
        assert part in text
    rows = longitudinal.table(0, 0)
    assert len(rows) == 81
    assert all(len(row) == len(rows[0]) for row in rows)
    body = json.loads(json.dumps(longitudinal.to_dict(), allow_nan=False))
    damping = body["transfers"][0]["modes"][0]["damping"]
    assert damping["low"] < damping["value"] < damping["high"]
    assert damping["value"] == pytest.approx(0.7835, abs=0.02)


def test_the_bode_plot_is_written(longitudinal: ChannelTransfers, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    draw_bode([longitudinal], tmp_path / "bode.svg")
    assert "theta_in to v_x" in (tmp_path / "bode.svg").read_text("utf-8")


def test_the_command_line(logs: dict[str, Path], tmp_path: Path) -> None:
    list(ingest_logs(find_logs([logs["ardrone-linear"]]), tmp_path / "data"))
    order = ("tf", "data", "-r", "ardrone-synthetic", "-c", "longitudinal", "--dead-time", "0", "--zeros")
    done = call(*order, "0", "--poles", "2", "--table", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "v_x / theta_in =" in done.stdout
    assert "model deg" in done.stdout
    failed = call(*order, "3", "--poles", "1", cwd=tmp_path)
    assert failed.returncode == 2
    assert "no more zeros than poles" in failed.stderr
    assert "Traceback" not in failed.stderr


def test_a_closed_loop_is_trusted_where_its_reference_moves_it(tmp_path: Path) -> None:
    """A table with a chirp added inside a loop: with and without its name, the plant's band is trusted."""
    data = Loop(0.2, rate_hz=100.0).flown(3)
    segment = data.segments[0]
    rows = np.column_stack([np.arange(len(segment)) * data.dt_s, segment.u, segment.y])
    log = tmp_path / "loop.csv"
    np.savetxt(log, rows, delimiter=",", header="time_s,u,chirp,rate", comments="", fmt="%.9g")
    order = ["tf", str(log), "--from", "u", "--to", "rate", "--poles", "2", "--zeros", "0", "--json", "-q"]
    plain = call(*order, cwd=tmp_path)
    assert plain.returncode == 0, plain.stderr
    direct = json.loads(plain.stdout)["channels"][0]
    assert direct["feedback"][0]["closed"]
    low, high = direct["measured"][0]["band_rad_s"]
    assert 2 * np.pi * SWEPT_HZ[0] < low < high < 2 * np.pi * SWEPT_HZ[1]
    done = call(*order, "--reference", "chirp", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    through = json.loads(done.stdout)["channels"][0]
    assert through["reference"] == ["chirp"]
    assert [t["input"] for t in through["transfers"]] == ["u"]
    low, high = through["measured"][0]["band_rad_s"]
    assert 2 * np.pi * SWEPT_HZ[0] < low < high < 2 * np.pi * SWEPT_HZ[1]
    wrong = call(*order, "--reference", "sweep", cwd=tmp_path)
    assert wrong.returncode == 2
    assert "no log has a field 'sweep'" in wrong.stderr


def test_no_figure_is_read_off_what_a_chirp_leaks(tmp_path: Path) -> None:
    """Beyond its last frequency all lines are leakage: a peak of S of 6.68 dB [6.67, 6.69] was printed for
    2.5."""
    record = draw_record(700100233, "loops")
    assert record.controller is not None
    true = loop_truth(record.plant, record.controller, record.data.dt_s)
    (segment,) = record.data.segments
    rows = np.column_stack([np.arange(len(segment)) * record.data.dt_s, segment.u, segment.y])
    log = tmp_path / "loop.csv"
    np.savetxt(log, rows, delimiter=",", header="time_s,u,r,y", comments="", fmt="%.12g")
    order = ["tf", str(log), "--from", "u", "--to", "y", "--poles", "1", "--zeros", "0", "--json", "-q"]
    done = call(*order, "--reference", "r", "--reference-at", record.reference, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)["channels"][0]["figures"]["loop"]
    peak = figures["sensitivity_peak_db"]
    assert peak["value"] is None or peak["low"] <= true["sensitivity_peak_db"] <= peak["high"]
    assert sum(figure["value"] is not None for figure in figures.values()) >= 1


def test_what_is_said_of_a_loop() -> None:
    data = Loop(0.2, rate_hz=100.0).flown(3)
    estimator = TF(poles=2, zeros=0)
    alone = "\n".join(identify_channel("rate", direct(data), estimator).lines())
    assert "a loop is closed, and where it reacts" in alone
    assert " rad/s. Trust it from 8.93 to 55.1 rad/s (1.4 to 8.8 Hz) only" in alone
    assert "response is -1/controller: so from " in alone
    assert "--reference FIELD" in alone
    found = identify_channel("rate", data, TF(poles=2, zeros=0, reference=["chirp"]))
    words = "\n".join(found.lines())
    assert "where the coherence of chirp with input and output is above 0.6" in words
    assert "caution" not in words
    assert len(found.table(0, 0)) > 20


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (["-c", "sideways"], "no channel 'sideways'"),
        (["--plot", "bode.bmp"], "no picture format"),
    ],
)
def test_wrong_orders_are_named(logs: dict[str, Path], tmp_path: Path, wrong: list[str], words: str) -> None:
    list(ingest_logs(find_logs([logs["ardrone-linear"]]), tmp_path / "data"))
    done = CliRunner().invoke(command, [str(tmp_path / "data"), "-r", "ardrone-synthetic", *wrong])
    assert isinstance(done.exception, UsageError)
    assert words in str(done.exception)


@pytest.mark.parametrize("seed", [77001000, 60005, 60052])
def test_a_model_follows_its_own_measurement_where_it_is_trusted(seed: int) -> None:
    """Gusts and drift chose the order by the free run: in "trust it from" the phase was off by 32 degrees."""
    record = draw_record(seed)
    names = ("r",) if record.controller else ()
    found = identify_channel("x", record.data, TF(reference=names))
    band = found.band(0, 0)
    measured = found.measured[0]
    assert band is not None
    assert measured is not None
    inside = (measured.omega >= band[0]) & (measured.omega <= band[1])
    off = np.log(found.response(0, 0, measured.omega)[0] / measured.response[:, 0])[inside]
    allowed = measured.half_width()[inside, 0]
    near = (np.abs(off.real) < allowed + 0.12) & (np.abs(off.imag) < allowed + np.radians(8.0))
    assert np.mean(near) > 0.9
    assert np.ptp(np.log2(measured.omega[inside])) > 2.0


def test_a_band_ends_where_model_and_measurement_part() -> None:
    """One pole asked for of a plant of three: its high end is no band of this model, and that is said."""
    rng = np.random.default_rng(5)
    dt_s = 0.02
    plant = Rational(np.array([1.0, 17.0, 84.0, 108.0]), (np.array([108.0]),), np.zeros(1))
    a, (b,) = sample(plant, dt_s, "zero")
    u = np.repeat(rng.standard_normal(600), 5)
    y = lfilter(b, a, u)
    data = Dataset.from_arrays(u, y + 0.01 * y.std() * rng.standard_normal(len(y)), dt_s)
    found = identify_channel("x", data, TF(poles=1, zeros=0, dead_time_s=0.0))
    measured = found.measured[0]
    band = found.band(0, 0)
    assert measured is not None
    coherent = measured.band(0)
    assert coherent is not None
    text = "\n".join(found.lines())
    if band is None:
        assert "model and measurement part everywhere" in text
    else:
        assert band[1] < 0.8 * coherent[1]
        assert "and the model within 1 dB and 7.57 degrees" in text
        assert text.count("rad/s (") == 1


def test_no_figure_is_printed_outside_its_band() -> None:
    """A pole of "16.4 +- 1.3 rad/s" stood beside a band that ended at 1.18, a gain of 6e9 beside no band."""
    plant = ContinuousTransfer(
        np.array([30.0]), np.array([1.0, 16.4, 6.56]), np.diag([0.1, 0.01, 0.01, 0.0]), 0.0, "u", "y"
    )
    whole = plant.words_in((0.1, 40.0))
    assert whole == str(plant)
    assert "time constant" in whole
    fast_unseen = plant.words_in((0.1, 1.2))
    assert "not determined (16 rad/s is outside it)" in fast_unseen
    assert "steady gain: 4.57" in fast_unseen
    slow_unseen = plant.words_in((2.0, 40.0))
    assert "steady gain: not determined: a pole lies below the trusted band" in slow_unseen
    nowhere = plant.words_in(None)
    assert "+-" not in nowhere
    assert "no band can be trusted" in nowhere
    figures = transfer_figures(plant, (2.0, 40.0))
    assert figures["gain"] is None
    assert [m["frequency_rad_s"] is None for m in figures["modes"]] == [True, False]


def test_noise_has_no_gain(tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    rows = np.column_stack([np.arange(3000) * 0.02, rng.standard_normal((3000, 2))])
    log = tmp_path / "noise.csv"
    np.savetxt(log, rows, delimiter=",", header="time_s,u,y", comments="", fmt="%.9g")
    order = ("tf", str(log), "--from", "u", "--to", "y", "--poles", "1", "--zeros", "0", "-q")
    done = call(*order, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "gain and poles: not determined" in done.stdout
    assert "+-" not in done.stdout
