"""One flight in every format: what is read back is the flight, within what each format can hold."""

from __future__ import annotations

import io
import socket
import threading
from dataclasses import fields
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import flysid
from flysid.cli.synth import command
from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.flight import TIME
from flysid.ingest.align.align import dataset
from flysid.ingest.formats.registry import all_formats
from flysid.ingest.synth.dryden import Gust
from flysid.ingest.synth.live import Pace, fly_live
from flysid.ingest.synth.rigid_body import Effects
from flysid.ingest.synth.synth import WRITERS, Order, flight_names, fly_one
from flysid.ingest.synth.telemetry import Recording, Telemetry, as_bytes
from flysid.ingest.synth.truth import truth_bytes
from flysid.ingest.synth.vehicles import EFFECTS
from flysid.ingest.synth.writers.ardrone import _wrapped_time
from flysid.ingest.synth.writers.ros_messages import ROS1, ROS2, layout
from tests.ingest.formats.test_blackbox import compare_with_chirp_core

BOLD = Order(plant="ardrone", plan="demo", duration_s=6.0, noise=0.02, seed=4)


@pytest.fixture(scope="module")
def recording() -> Recording:
    """A turning flight: the heading is not zero, so that frames cannot be mixed up unseen."""
    flown = fly_one(BOLD, 0)
    psi = flown.state["psi"] + np.linspace(0, 40, len(flown.state))
    return Recording(
        **{**vars(flown), "state": Telemetry(flown.state.time_ns, {**flown.state.values, "psi": psi})}
    )


def read_back(recording: Recording, name: str, folder: Path) -> flysid.Flight:
    suffix, encode = WRITERS[name]
    if not any(suffix.endswith(s) for f in all_formats().values() for s in f.suffixes):
        pytest.skip(f"no reader of {suffix} yet")
    path = folder / f"flight{suffix}"
    path.write_bytes(encode(recording))
    flight = flysid.read(path)
    assert not flight.damage.lossy
    assert not flight.damage.sequence_gaps
    return flight


def column(flight: flysid.Flight, stream: str, name: str) -> FloatArray:
    return np.array(flight[stream][name].to_pylist(), dtype=np.float64)


def along_heading(north: FloatArray, east: FloatArray, psi_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    c = np.cos(np.radians(psi_deg))
    s = np.sin(np.radians(psi_deg))
    return c * north + s * east, -s * north + c * east


def euler(q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Roll, pitch, yaw in degrees of (N, 4) w, x, y, z."""
    w, x, y, z = q.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.degrees(roll), np.degrees(np.arcsin(2 * (w * y - z * x))), np.degrees(yaw)


def close(got: FloatArray, expected: FloatArray, step: float) -> None:
    np.testing.assert_allclose(got, expected, atol=step)


def test_dataflash(recording: Recording, tmp_path: Path) -> None:
    flight = read_back(recording, "dataflash", tmp_path)
    state = recording.state
    sent = recording.command
    np.testing.assert_array_equal(column(flight, "ATT", "TimeUS") * 1000, state.time_ns)
    close(column(flight, "ATT", "DesPitch") / 100, -sent["theta_in"], 0.00501)
    close(column(flight, "ATT", "DesRoll") / 100, sent["phi_in"], 0.00501)
    close(column(flight, "ATT", "Roll") / 100, state["phi"], 0.00501)
    close(column(flight, "CTUN", "DCRt") / 100, sent["vz_in"], 0.00501)
    ahead, right = along_heading(
        column(flight, "XKF1", "VN"), column(flight, "XKF1", "VE"), column(flight, "XKF1", "Yaw") / 100
    )
    close(ahead, state["vx"], 1e-3)
    close(right, state["vy"], 1e-3)
    close(-column(flight, "XKF1", "VD"), state["vz"], 1e-6)
    units = {f.name: f.metadata for f in flight["ATT"].schema}
    assert units["DesRoll"][b"unit"] == b"deg"
    assert float(units["DesRoll"][b"scale"]) == pytest.approx(0.01)
    assert float({f.name: f.metadata for f in flight["CTUN"].schema}["DCRt"][b"scale"]) == pytest.approx(0.01)


def test_ulog(recording: Recording, tmp_path: Path) -> None:
    flight = read_back(recording, "ulog", tmp_path)
    state = recording.state
    sent = recording.command
    roll, pitch, _ = euler(column(flight, "vehicle_attitude_setpoint", "q_d"))
    close(roll, sent["phi_in"], 2e-5)
    close(-pitch, sent["theta_in"], 2e-5)
    roll, pitch, yaw = euler(column(flight, "vehicle_attitude", "q"))
    close(roll, state["phi"], 2e-5)
    close(-pitch, state["theta"], 2e-5)
    close(yaw, state["psi"], 2e-5)
    close(-column(flight, "vehicle_local_position_setpoint", "vz"), sent["vz_in"], 1e-6)
    thrust = -column(flight, "vehicle_attitude_setpoint", "thrust_body")[:, 2]
    close(thrust, recording.truth["thrust"] / 2, 1e-6)
    assert 0.01 < np.std(thrust) < 0.2
    where = "vehicle_local_position"
    ahead, right = along_heading(column(flight, where, "vx"), column(flight, where, "vy"), state["psi"])
    close(ahead, state["vx"], 1e-5)
    close(right, state["vy"], 1e-5)
    close(np.degrees(column(flight, where, "heading")), state["psi"], 1e-4)


def test_ulog_is_what_pyulog_reads(recording: Recording, tmp_path: Path) -> None:
    from pyulog import ULog

    path = tmp_path / "flight.ulg"
    path.write_bytes(WRITERS["ulog"][1](recording))
    log = ULog(str(path))
    assert not log.file_corruption
    got = log.get_dataset("vehicle_local_position").data
    close(got["vz"], -recording.state["vz"], 1e-6)


def test_blackbox(recording: Recording, tmp_path: Path) -> None:
    flight = read_back(recording, "blackbox", tmp_path)
    state = recording.state
    sent = recording.command
    np.testing.assert_array_equal(column(flight, "main", TIME), state.time_ns)
    for axis, name in enumerate("pqr"):
        close(0.1 * column(flight, "main", f"gyroADC[{axis}]"), state[name], 0.0501)
    close(0.1 * column(flight, "main", "setpoint[0]"), 5 * (sent["phi_in"] - state["phi"]), 0.0501)
    close(0.1 * column(flight, "main", "setpoint[1]"), 5 * (sent["theta_in"] - state["theta"]), 0.0501)
    close(0.01 * column(flight, "main", "baroAlt") - 20.0, state["z"], 0.00501)
    # Betaflight's mixer of a quadrotor X, taken apart again
    motors = np.array([column(flight, "main", f"motor[{k}]") for k in range(4)])
    roll = (motors[2] + motors[3] - motors[0] - motors[1]) / 4 / (2047 - 48)
    free = ((motors > 48) & (motors < 2047)).all(axis=0)
    assert free.mean() > 0.9
    close(roll[free], 0.5 * state["roll_effort"][free], 0.001)
    close(0.001 * column(flight, "main", "axisP[1]"), -0.5 * state["pitch_effort"], 0.000501)
    assert np.corrcoef(np.diff(state["p"]), state["roll_effort"][:-1])[0, 1] > 0.3
    north_m = 111_319.49 * (1e-7 * column(flight, "gps", "GPS_coord[0]") - 47.3977420)
    due = np.isin(state.time_ns, column(flight, "gps", TIME).astype(np.int64))
    close(north_m, state["x"][due], 0.012)
    assert flight.info["vehicle"] == f"flysid {recording.system}"
    assert (flight.clocks[0].utc_offset_ns or 0) == recording.boot_utc_ns


def test_blackbox_is_what_chirp_core_reads(recording: Recording, tmp_path: Path) -> None:
    holed = Recording(**{**vars(recording), "lost": ((13 * 10**9, 14 * 10**9),)})
    path = tmp_path / "flight.bbl"
    path.write_bytes(WRITERS["blackbox"][1](holed))
    compare_with_chirp_core(path)


def test_a_blackbox_of_the_simulator_serves_the_rate_recipe(tmp_path: Path) -> None:
    path = tmp_path / "flight.bbl"
    flown = fly_one(Order(plant="ardrone", plan="demo", duration_s=6.0, sensor="navdata", seed=5), 0)
    path.write_bytes(WRITERS["blackbox"][1](flown))
    data = dataset([flysid.read(path)], "betaflight-rate", "roll_motors")
    assert data.dt_s == pytest.approx(0.005)
    close(data.segments[0].y[:, 0], flown.state["p"][: len(data.segments[0].y)], 0.0501)


@pytest.mark.parametrize("name", ["mcap-ros1", "mcap-ros2"])
def test_ros(recording: Recording, name: str, tmp_path: Path) -> None:
    flight = read_back(recording, name, tmp_path)
    state = recording.state
    sent = recording.command
    limit = np.degrees(0.209)
    close(column(flight, "/cmd_vel", "linear.x") * limit, sent["theta_in"], 1e-9)
    close(-column(flight, "/cmd_vel", "linear.y") * limit, sent["phi_in"], 1e-9)
    close(column(flight, "/cmd_vel", "linear.z") * 0.7, sent["vz_in"], 1e-9)
    nav = "/ardrone/navdata"
    close(column(flight, nav, "vx") / 1000, state["vx"], 1e-6)
    close(-column(flight, nav, "vy") / 1000, state["vy"], 1e-6)
    names = ("rotY", "rotX") if name == "mcap-ros1" else ("rot_y", "rot_x")
    close(column(flight, nav, names[0]), state["theta"], 1e-5)
    close(column(flight, nav, names[1]), state["phi"], 1e-5)
    close(column(flight, nav, "altd") / 1000 - 20.0, state["z"], 0.000501)
    np.testing.assert_array_equal(
        np.array(flight[nav][TIME].to_pylist()), state.time_ns + recording.boot_utc_ns
    )
    close(-column(flight, "/pose", "pose.position.y"), state["y"], 1e-12)
    q = np.column_stack([column(flight, "/pose", f"pose.orientation.{a}") for a in "wxyz"])
    close(np.sum(q**2, axis=1), np.ones(len(q)), 1e-12)
    close(euler(q)[2], -state["psi"], 0.6)  # another order of turns: equal for small tilt only


def test_ros_messages_are_what_the_official_decoders_read(recording: Recording) -> None:
    from mcap.reader import make_reader
    from mcap_ros1.decoder import DecoderFactory as Ros1
    from mcap_ros2.decoder import DecoderFactory as Ros2

    for name, factory in (("mcap-ros1", Ros1()), ("mcap-ros2", Ros2())):
        reader = make_reader(io.BytesIO(WRITERS[name][1](recording)), decoder_factories=[factory])
        navdata = [m[3] for m in reader.iter_decoded_messages(topics=["/ardrone/navdata"])]
        assert len(navdata) == len(recording.state)
        field = "rotX" if name == "mcap-ros1" else "rot_x"
        close(np.array([getattr(m, field) for m in navdata]), recording.state["phi"], 1e-5)
        assert navdata[7].tm == pytest.approx(recording.state.time_ns[7] / 1000)
        assert navdata[7].header.frame_id == "ardrone_base_link"


@pytest.mark.parametrize("name", ["navdata", "pcap"])
def test_navdata(recording: Recording, name: str, tmp_path: Path) -> None:
    flight = read_back(recording, name, tmp_path)
    state = recording.state
    sent = recording.command
    close(column(flight, "demo", "vx") / 1000, state["vx"], 1e-6)
    close(column(flight, "demo", "vy") / 1000, state["vy"], 1e-6)
    close(-column(flight, "demo", "theta") / 1000, state["theta"], 1e-5)
    close(-column(flight, "references", "ref_theta") / 1000, sent["theta_in"], 0.000501)
    close(column(flight, "references", "ref_phi") / 1000, sent["phi_in"], 0.000501)
    close(column(flight, "pwm", "vz_ref") / 1000, sent["vz_in"], 1e-6)
    close(column(flight, "altitude", "altitude_vz") / 1000, state["vz"], 1e-6)
    if name == "pcap":
        close(-column(flight, "at/PCMD", "pitch") * np.degrees(0.209), sent["theta_in"], 1e-5)


def test_navdata_packets_have_right_checksums_and_the_clock_wraps(recording: Recording) -> None:
    blob = WRITERS["navdata"][1](recording)
    size = len(blob) // len(recording.state)
    for i in (0, 17):
        packet = blob[i * size : (i + 1) * size]
        assert int.from_bytes(packet[-4:], "little") == sum(packet[:-8])
        assert int.from_bytes(packet[8:12], "little") == i + 1
    assert _wrapped_time(np.array([2048 * 10**9 + 5000]))[0] == 5


@pytest.mark.parametrize("name", sorted(WRITERS))
def test_every_format_is_the_same_every_time_and_loses_what_was_lost(
    recording: Recording, name: str, tmp_path: Path
) -> None:
    suffix, encode = WRITERS[name]
    assert encode(recording) == encode(recording)
    start = int(recording.state.time_ns[100])
    holed = Recording(**{**vars(recording), "lost": ((start, start + 400_000_000),)})
    assert len(encode(holed)) < len(encode(recording))
    if any(suffix.endswith(s) for f in all_formats().values() for s in f.suffixes):
        path = tmp_path / f"holed{suffix}"
        path.write_bytes(encode(holed))
        assert not flysid.read(path).damage.lossy


def test_truth_lies_beside_in_the_papers_signs(recording: Recording) -> None:
    table = pq.read_table(io.BytesIO(truth_bytes(recording)))
    assert table.column_names[:4] == [TIME, "theta_in", "phi_in", "vz_in"]
    np.testing.assert_array_equal(table["vx"].to_numpy(), recording.truth["vx"])
    assert table.schema.field("vx").metadata[b"unit"] == b"m/s"


def test_cdr_aligns_and_ros1_does_not() -> None:
    fields = [("a", "u1"), ("b", "<f8"), ("c", "<u4")]
    assert [layout(fields, True).fields[n][1] for n in "abc"] == [4, 12, 20]  # type: ignore[index]
    assert layout(fields, False).itemsize == 13
    assert ROS2.aligned
    assert not ROS1.aligned
    rows = np.zeros(2, dtype=layout(fields, True))
    assert [len(b) for b in as_bytes(rows)] == [24, 24]


def test_a_fleet_is_dispersed_and_its_first_vehicle_is_the_nominal_one() -> None:
    fleet = Order(plant="ardrone", plan="steps", duration_s=4.0, seed=4, fleet=3)
    names = flight_names(fleet)
    assert names[0].startswith("v001-01-steps")
    assert len(names) == 3
    ones = [fly_one(fleet, i) for i in range(3)]
    assert [r.system for r in ones] == [1, 2, 3]
    alone = fly_one(Order(plant="ardrone", plan="steps", duration_s=4.0, seed=4), 0)
    np.testing.assert_array_equal(ones[0].truth["vx"], alone.truth["vx"])
    assert ones[1].boot_utc_ns != ones[0].boot_utc_ns


def test_processes_write_what_one_process_writes(tmp_path: Path) -> None:
    args = ["--plan", "steps", "--duration", "2", "--fleet", "2", "-q"]
    for folder, jobs in (("one", "1"), ("two", "2")):
        done = CliRunner().invoke(
            command, ["-o", str(tmp_path / folder), "-j", jobs, *args], catch_exceptions=False
        )
        assert done.exit_code == 0
        assert len(done.stdout.splitlines()) == 2
        assert len(list((tmp_path / folder).iterdir())) == 4
    for path in sorted((tmp_path / "one").iterdir()):
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()


def test_wind_is_refused_by_plants_that_do_not_feel_it_and_felt_by_the_other() -> None:
    with pytest.raises(UsageError, match="neither wind nor effects"):
        Order(wind_m_s=3.0)
    calm = fly_one(BOLD, 0)
    windy = fly_one(Order(**{**vars(BOLD), "wind_m_s": 4.0}), 0)
    gust = fly_one(Order(**{**vars(BOLD), "gusts": (Gust(1.0, 1.0, (0.0, 3.0, 0.0)),)}), 0)
    for other, least in ((windy, 0.1), (gust, 0.1)):
        assert np.abs(other.truth["vy"] - calm.truth["vy"]).max() > least
    np.testing.assert_array_equal(gust.truth["vy"][:50], calm.truth["vy"][:50])


def test_effects_can_be_switched_off_by_name() -> None:
    assert tuple(f.name for f in fields(Effects)) == EFFECTS
    whole = fly_one(BOLD, 0)
    without = fly_one(Order(**{**vars(BOLD), "without": ("quadratic_drag",)}), 0)
    assert np.abs(whole.truth["vx"] - without.truth["vx"]).max() > 1e-3
    with pytest.raises(UsageError, match="no effect 'gravity'"):
        Order(plant="ardrone", without=("gravity",))


def test_the_ground_is_felt_near_it() -> None:
    low = fly_one(Order(**{**vars(BOLD), "duration_s": 2.0, "altitude_m": 1.0}), 0)
    high = fly_one(Order(**{**vars(BOLD), "duration_s": 2.0, "altitude_m": 50.0}), 0)
    assert 1e-4 < np.abs(low.truth["vz"] - high.truth["vz"]).max() < 0.1


def test_live_flights_are_heard_by_mavutil() -> None:
    from pymavlink import mavutil

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    ear = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}")
    heard: list[object] = []

    def listen() -> None:
        heard.extend(ear.recv_match(blocking=True, timeout=5) for _ in range(40))

    listener = threading.Thread(target=listen)
    listener.start()
    order = Order(plan="steps", duration_s=1.0)
    sent = fly_live(order, f"udp:127.0.0.1:{port}", Pace(5.0))
    listener.join()
    ear.close()
    assert sent == 4 * 50 + 1
    kinds = {m.get_type() for m in heard}  # type: ignore[attr-defined]
    assert {"HEARTBEAT", "ATTITUDE", "ATTITUDE_TARGET", "LOCAL_POSITION_NED"} <= kinds


def test_live_keeps_time() -> None:
    now = [100.0]

    def sleep(seconds: float) -> None:
        now[0] += seconds

    pace = Pace(2.0, clock=lambda: now[0], sleep=sleep)
    fly_live(Order(plan="steps", duration_s=3.0), "udp:127.0.0.1:9", pace)
    assert now[0] - 100.0 == pytest.approx((3.0 - 0.02) / 2)


@pytest.mark.parametrize(
    "target", ["tcp:127.0.0.1:14550", "udp:127.0.0.1", "udp::1", "udp:h:0", "udp:h:70000"]
)
def test_live_targets_that_make_no_sense_are_refused(target: str) -> None:
    with pytest.raises(UsageError, match=r"no live target|no port"):
        fly_live(Order(duration_s=1.0), target)
