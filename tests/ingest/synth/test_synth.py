"""flysid synth: what is written can be read, says what was flown, and is the same every time."""

from __future__ import annotations

import hashlib
import json
import re
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import flysid
from flysid.cli.synth import command
from flysid.errors import UsageError
from flysid.flight import RECEIVED, TIME
from flysid.ingest.synth.plans import PLANS
from flysid.ingest.synth.synth import EPOCH_NS, WRITERS, Order, flights, fly_one
from flysid.ingest.synth.telemetry import Recording

ROOT = Path(__file__).resolve().parents[3]
SHORT = Order(plan="steps", duration_s=4.0, noise=0.02, seed=3)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return fly_one(SHORT, 0)


def column(flight: flysid.Flight, stream: str, name: str) -> np.ndarray:
    return np.array(flight[stream][name].to_pylist(), dtype=np.float64)


def written(recording: Recording, name: str, folder: Path) -> flysid.Flight:
    suffix, encode = WRITERS[name]
    path = folder / f"flight{suffix}"
    path.write_bytes(encode(recording))
    return flysid.read(path)


def test_a_telemetry_log_says_in_mavlinks_signs_what_was_flown(recording: Recording, tmp_path: Path) -> None:
    flight = written(recording, "tlog", tmp_path)
    assert not flight.damage.lossy
    assert not flight.damage.sequence_gaps
    w, x, y, z = column(flight, "1.1/ATTITUDE_TARGET", "q").T
    roll = np.degrees(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
    pitch = np.degrees(np.arcsin(2 * (w * y - z * x)))
    np.testing.assert_allclose(roll, recording.command["phi_in"], atol=2e-5)
    np.testing.assert_allclose(pitch, -recording.command["theta_in"], atol=2e-5)
    climb = column(flight, "1.1/SET_POSITION_TARGET_LOCAL_NED", "vz")
    np.testing.assert_allclose(climb, -recording.command["vz_in"], atol=1e-6)
    for name, sign in (("vx", 1), ("vy", 1), ("vz", -1)):
        measured = column(flight, "1.1/LOCAL_POSITION_NED", name)
        np.testing.assert_allclose(measured, sign * recording.state[name], atol=1e-6)
    np.testing.assert_allclose(
        np.degrees(column(flight, "1.1/ATTITUDE", "pitch")), -recording.state["theta"], atol=1e-5
    )


def test_a_self_described_log_keeps_the_papers_signs_and_names_units(
    recording: Recording, tmp_path: Path
) -> None:
    flight = written(recording, "mcap", tmp_path)
    assert not flight.damage.lossy
    for stream, series in (("/ardrone/command", recording.command), ("/ardrone/state", recording.state)):
        for name in flight[stream].column_names[4:]:
            np.testing.assert_allclose(column(flight, stream, name), series[name], atol=6e-7)
    units = {f.name: (f.metadata or {}).get(b"unit") for f in flight["/ardrone/state"].schema}
    assert (units["vx"], units["theta"], units["z"]) == (b"m/s", b"deg", b"m")


@pytest.mark.parametrize("name", ["tlog", "mcap"])
def test_times_are_exact_and_arrivals_are_late_and_in_order(
    recording: Recording, name: str, tmp_path: Path
) -> None:
    flight = written(recording, name, tmp_path)
    stream = {"tlog": "1.1/LOCAL_POSITION_NED", "mcap": "/ardrone/state"}[name]
    offset = {"tlog": 0, "mcap": EPOCH_NS}[name]
    np.testing.assert_array_equal(
        np.array(flight[stream][TIME].to_pylist()) - offset, recording.state.time_ns
    )
    arrival = np.array(flight[stream][RECEIVED].to_pylist())
    late_ms = (arrival - recording.boot_utc_ns - recording.state.time_ns) / 1e6
    assert late_ms.min() > 5.9
    assert 8 < late_ms.mean() < 20
    assert late_ms.std() > 2
    assert (np.diff(arrival) >= 0).all()


@pytest.mark.parametrize("name", ["tlog", "mcap"])
def test_a_drop_out_leaves_a_hole_and_nothing_else(name: str, tmp_path: Path) -> None:
    whole = fly_one(SHORT, 0)
    holed = fly_one(Order(plan="steps", duration_s=4.0, noise=0.02, seed=3, dropouts_s=((1.0, 0.5),)), 0)
    flight = written(holed, name, tmp_path)
    stream = {"tlog": "1.1/LOCAL_POSITION_NED", "mcap": "/ardrone/state"}[name]
    times = np.array(flight[stream][TIME].to_pylist())
    assert len(times) == len(whole.state) - 25
    assert np.diff(times).max() == 520_000_000
    assert not flight.damage.lossy
    if name == "tlog":
        assert sum(flight.damage.sequence_gaps.values()) == 4 * 25 + 1  # and a heartbeat


@pytest.mark.parametrize("plan", sorted(PLANS))
def test_every_plan_flies_bounded_and_seeded(plan: str) -> None:
    order = Order(plan=plan, duration_s=20.0, seed=2)
    first = flights(order)
    again = flights(order)
    for a, b in zip(first, again, strict=True):
        for name, values in a.state.values.items():
            np.testing.assert_array_equal(values, b.state[name])
            assert np.isfinite(values).all()
        for name, values in a.command.values.items():
            assert 0.2 < np.abs(values).max() <= (12.0 if plan == "demo" else 5.0) + 1e-9, name
    other = fly_one(Order(plan=plan, duration_s=20.0, seed=9), 0)
    differs = not np.array_equal(first[0].command["theta_in"], other.command["theta_in"])
    assert differs == (
        plan not in ("paper", "paper-training", "paper-validation", "chirp", "amplitude-sweep")
    )


def test_noise_is_on_the_velocities_only(recording: Recording) -> None:
    for name, values in recording.truth.values.items():
        error = recording.state[name] - values
        assert np.std(error) == (pytest.approx(0.02, rel=0.2) if name in ("vx", "vy", "vz") else 0.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"plant": "blimp"}, "no plant 'blimp'"),
        ({"duration_s": 0.0}, "flight of 0 s"),
        ({"duration_s": float("nan")}, "flight of nan s"),
        ({"noise": -1.0}, "noise"),
        ({"amplitude": float("inf")}, "amplitude"),
        ({"dropouts_s": ((1.0, 0.0),)}, "a dropout at 1 s of 0 s"),
    ],
)
def test_orders_that_cannot_be_flown_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Order(**changes)  # type: ignore[arg-type]


def test_the_command_prints_paths_and_overwrites_only_when_told(tmp_path: Path) -> None:
    args = ["-o", str(tmp_path), "--plan", "steps", "--duration", "2", "--format", "tlog", "--format", "mcap"]
    done = CliRunner().invoke(command, args, catch_exceptions=False)
    paths = [Path(line) for line in done.stdout.splitlines()]
    assert [p.name for p in paths] == ["01-steps-seed1.tlog", "01-steps-seed1.mcap"]
    before = [p.read_bytes() for p in paths]
    with pytest.raises(UsageError, match="exists"):
        CliRunner().invoke(command, args, catch_exceptions=False)
    CliRunner().invoke(command, [*args, "--force"], catch_exceptions=False)
    assert [p.read_bytes() for p in paths] == before
    beside = {"01-steps-seed1.truth.parquet"}
    assert {p.name for p in tmp_path.iterdir()} == {p.name for p in paths} | beside


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (["--plan", "multisin"], "no flight plan 'multisin'"),
        (["--format", "csv"], "no format 'csv'"),
        (["--dropout", "20"], "no dropout '20'"),
    ],
)
def test_wrong_usage_is_named(extra: list[str], message: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=message):
        CliRunner().invoke(command, ["-o", str(tmp_path / "x"), *extra], catch_exceptions=False)
    assert not (tmp_path / "x").exists()


def test_the_command_lists_what_it_knows() -> None:
    listed = CliRunner().invoke(command, ["--list"], catch_exceptions=False).stdout.splitlines()
    assert "plan\tpaper-training" in listed
    assert "format\tmcap" in listed


def sample_commands() -> list[list[str]]:
    """The arguments of every `flysid synth` in the Makefile's target `samples`."""
    lines = re.findall(r"-m flysid synth (.*)$", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    return [shlex.split(line) for line in lines]


def test_sample_logs_are_what_the_makefile_makes_bit_for_bit(tmp_path: Path) -> None:
    lines = (ROOT / "sample_logs/SHA256SUMS").read_text().splitlines()
    sums = {name: digest for digest, name in (line.split() for line in lines)}
    for args in sample_commands():
        args[args.index("-o") + 1] = str(tmp_path)
        assert CliRunner().invoke(command, args, catch_exceptions=False).exit_code == 0
    made = {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in tmp_path.iterdir()}
    kept = {
        p.name: hashlib.sha256(p.read_bytes()).hexdigest()
        for p in (ROOT / "sample_logs").iterdir()
        if p.suffix in (".tlog", ".mcap")
    }
    assert made == kept == sums
    assert sum(p.stat().st_size for p in (ROOT / "sample_logs").iterdir()) <= 2_000_000


def test_the_schema_in_the_file_is_json(recording: Recording) -> None:
    text = WRITERS["mcap"][1](recording)
    assert text.startswith(b"\x89MCAP0\r\n")
    start = text.index(b'{"$schema"')
    schema = json.JSONDecoder().raw_decode(text[start : start + 2000].decode("latin-1"))[0]
    assert schema["properties"]["stamp"]["unit"] == "ns"


def test_flying_and_writing_do_not_import_slow_libraries() -> None:
    import subprocess

    code = (
        "from flysid.ingest.synth.synth import Order, fly_one, WRITERS; import sys;"
        "r = fly_one(Order(plan='steps', duration_s=2.0), 0); [w(r) for _, w in WRITERS.values()];"
        "print(sorted({'control', 'scipy.signal', 'pandas', 'matplotlib'} & set(sys.modules)))"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True, timeout=60
    ).stdout
    assert out.strip() == "[]"
