"""Whole flights: simulated ones with known faults, and the real AR.Drone's."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import flysid
from bench.kinematics import INJECTED, Faults, flown
from flysid.flight import Flight
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.align.signals import FlightLog, load_signal
from flysid.ingest.kinematics.compatibility import Compatibility, Parameter, compatibility
from flysid.ingest.kinematics.telling import Instruments, as_document, corrected_recipe, lines
from tests.command import call
from tests.samplelogs.ardrone import bag, read_flight

SHARED = Path(__file__).parents[3] / ".." / "shared" / "logs"
SECONDS = 40.0


@cache
def faulty() -> FlightLog:
    return FlightLog(flown(7, INJECTED, SECONDS))


@cache
def compared() -> Compatibility:
    return compatibility(faulty())


def number(found: Compatibility, signal: str, kind: str, instrument: str = "") -> Parameter:
    """One of all that was estimated."""
    numbers = [p for c in found.comparisons for p in c.parameters]
    return next(
        p for p in numbers if (p.signal, p.kind) == (signal, kind) and instrument in ("", p.instrument)
    )


@pytest.mark.parametrize(
    ("signal", "kind", "instrument", "truth"),
    [
        ("p", "bias", "gyro", np.radians(0.5)),
        ("q", "scale", "gyro", 1.05),
        ("", "lag", "gyro", 0.03),
        ("f_x", "bias", "accelerometer", 0.1),
        ("f_y", "scale", "accelerometer", 1.05),
        ("", "lag", "accelerometer", 0.03),
        ("", "arm forward", "accelerometer", 0.05),
        ("v_north", "scale", "velocity", 0.95),
        ("", "lag", "velocity", 0.03),
    ],
)
def test_injected_faults_are_found(signal: str, kind: str, instrument: str, truth: float) -> None:
    found = number(compared(), signal, kind, instrument)
    assert found.found
    assert abs(found.value - truth) < 3.5 * found.sd


def test_a_clean_flight_has_no_finding() -> None:
    found = compatibility(FlightLog(flown(8, Faults(), SECONDS)))
    assert not found.findings
    assert [line.rpartition(": ")[2] for line in lines(found) if "compared" in line] == ["agree"] * 3


def test_a_jump_of_the_estimator_is_left_out() -> None:
    flight = flown(8, Faults(), SECONDS)
    table = flight.tables["vehicle_local_position"]
    jumped = table["x"].to_numpy() + np.where(np.arange(len(table)) > 1000, 25.0, 0.0)
    table = table.set_column(table.column_names.index("x"), "x", pa.array(jumped))
    found = compatibility(
        FlightLog(Flight(flight.source, {**flight.tables, "vehicle_local_position": table}))
    )
    assert not found.findings
    assert 0.05 < found.comparisons[0].cut_s < 1.0


def test_a_vehicle_that_stands_is_told_to_fly() -> None:
    flight = flown(8, Faults(), SECONDS)
    still = {}
    rng = np.random.default_rng(0)
    for stream, table in flight.tables.items():
        for i, name in enumerate(table.column_names[2:], 2):
            first = np.array(table[name][0].as_py())
            rows = first + 1e-4 * rng.standard_normal((len(table), *first.shape))
            column = (
                pa.array(rows)
                if rows.ndim == 1
                else pa.FixedSizeListArray.from_arrays(rows.ravel(), 4 if rows.shape[1] == 4 else 3)
            )
            table = table.set_column(i, name, column)
        still[stream] = table
    found = compatibility(FlightLog(Flight(flight.source, still)))
    assert "roll rate did not move enough for a scale; fly roll doublets" in " ".join(lines(found))
    assert not [p for p in found.findings if p.kind in ("scale", "lag")]


RECIPE = """
name = "gyro"
[signals.u]
unit = "deg/s"
sources = [{ stream = "vehicle_angular_velocity", field = "xyz[0]", unit = "rad/s" }]
[signals.y]
unit = "deg/s"
sources = [
  { stream = "vehicle_angular_velocity", field = "xyz[1]", unit = "rad/s", scale = -2.0, offset = 1.0 },
]
[channels.c]
inputs = ["u"]
outputs = ["y"]
"""


def test_a_corrected_recipe_gives_what_a_right_instrument_would(tmp_path: Path) -> None:
    (tmp_path / "r.toml").write_text(RECIPE)
    text, done = corrected_recipe(str(tmp_path / "r.toml"), faulty(), compared())
    (tmp_path / "c.toml").write_text(text)
    assert [line.partition(":")[0] for line in done] == ["u", "y"]
    right = FlightLog(flown(7, Faults(), SECONDS))
    for signal in ("u", "y"):
        corrected = load_signal(signal, load_recipe(tmp_path / "c.toml").signals[signal], faulty()).boots[0]
        clean = load_signal(signal, load_recipe(tmp_path / "r.toml").signals[signal], right).boots[0]
        off = np.interp(clean.t_ns, corrected.t_ns, corrected.x)[50:-50] - clean.x[50:-50]
        assert abs(np.mean(off)) < 0.05  # deg/s, of 0.5 and, for y, of twice that
        assert np.std(off) < 1.5  # of 3 and more where 30 ms and 5 % are left in


def test_the_channel_that_uses_a_faulty_field_has_a_doubt(tmp_path: Path) -> None:
    (tmp_path / "r.toml").write_text(RECIPE)
    found = Instruments([faulty()]).doubts(load_recipe(tmp_path / "r.toml"), "c")
    assert {d.kind for d in found} == {"kinematics"}
    assert any(d.text.startswith("roll rate (vehicle_angular_velocity.xyz[0]) reads 0.") for d in found)
    assert not any("specific force" in d.text for d in found)


@pytest.mark.skipif(not SHARED.exists(), reason="the real logs are not here")
def test_the_two_scales_of_the_real_ardrone(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    path.write_bytes(bag(*read_flight(SHARED)))
    found = compatibility(FlightLog(flysid.read(path)))
    forward = number(found, "v_forward", "scale")
    right = number(found, "v_right", "scale")
    assert forward.found
    assert right.found
    assert forward.interval[1] < 0.85
    assert right.interval[1] < 0.9


def test_doctor_says_whether_the_instruments_agree(tmp_path: Path) -> None:
    log = Path("sample_logs/01-multisine-seed1.tlog").absolute()
    told = call("doctor", log, "--kinematics", "--correct", "ardrone-synthetic", cwd=tmp_path)
    assert "velocity against the position's rate: 30 s compared: agree" in told.stdout
    assert "no field of recipe 'ardrone-synthetic' was found at fault" in told.stderr
    assert call("doctor", log, "--correct", "ardrone-synthetic", cwd=tmp_path).returncode == 2


def test_all_that_was_estimated_is_in_the_document() -> None:
    document = json.loads(json.dumps(as_document(compared())))
    assert document["findings"] == len(compared().findings)
    gyro = next(c for c in document["comparisons"] if c["instrument"] == "gyro")
    lag = next(n for n in gyro["numbers"] if n["kind"] == "lag")
    assert lag["found"]
    assert lag["interval"][0] < lag["value"] < lag["interval"][1]
    assert lag["words"].startswith("gyro (vehicle_angular_velocity) is 30")
