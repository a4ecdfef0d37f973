"""The AR.Drone recipe: a simulated motion with known truth, and the real flight with motion capture."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import flysid
from flysid.flight import Flight
from flysid.ingest.align.align import align
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.lake.suggest import suggest
from flysid.stretch import FloatArray
from tests.samplelogs.ardrone import bag, read_flight

SHARED = Path(__file__).parents[3] / ".." / "shared" / "logs"
START = 1.6e9  # seconds, UTC


def smooth(t: FloatArray, seed: int, scale: float) -> FloatArray:
    """A sum of tones up to 1.2 Hz, of the given standard deviation."""
    rng = np.random.default_rng(seed)
    tones = zip(rng.uniform(0.05, 1.2, 30), rng.uniform(0, 6.28, 30), strict=True)
    return np.asarray(scale * sum(np.sin(2 * np.pi * f * t + p) for f, p in tones) / np.sqrt(15.0))


def simulated(duration_s: float = 150.0) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Navdata and motion capture of one motion, each with noise; navdata with jitter and drop-outs."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, duration_s, 1 / 1000)
    roll = np.radians(smooth(t, 1, 4.0))
    pitch = np.radians(smooth(t, 2, 3.0))
    yaw = smooth(t, 3, 0.6)
    forward = smooth(t, 4, 0.8)
    left = smooth(t, 5, 0.5)
    v_x = forward * np.cos(yaw) - left * np.sin(yaw)
    v_y = forward * np.sin(yaw) + left * np.cos(yaw)
    position = [np.cumsum(v) / 1000 for v in (v_x, v_y)]

    t_nav = np.sort(
        np.arange(0.0, duration_s - 0.01, 1 / 198)
        + rng.uniform(0, 2e-3, int(np.ceil((duration_s - 0.01) * 198)))
    )
    t_nav = t_nav[(t_nav < 60.0) | (t_nav > 61.0)]
    at = {
        name: np.interp(t_nav, t, x)
        for name, x in [("roll", roll), ("pitch", pitch), ("f", forward), ("l", left)]
    }
    noise = rng.normal(scale=0.05, size=(2, len(t_nav)))
    nav = {
        "stamp": START + t_nav,
        "rotX_deg": np.degrees(at["roll"]) + noise[0],
        "rotY_deg": np.degrees(at["pitch"]) + noise[1],
        "rotZ_deg": np.zeros(len(t_nav)),
        "altd_mm": np.full(len(t_nav), 900.0),
        "vx_mm_s": 1000 * at["f"],
        "vy_mm_s": 1000 * at["l"],
        "vz_mm_s": np.zeros(len(t_nav)),
        **{f"motor{i}": np.zeros(len(t_nav)) for i in range(1, 5)},
    }
    t_pose = np.arange(1.0, duration_s - 1.0, 1 / 120)
    angles = np.column_stack([np.interp(t_pose, t, a) for a in (yaw, pitch, roll)])
    q = Rotation.from_euler("ZYX", angles).as_quat()
    xy = [np.interp(t_pose, t, p) + rng.normal(scale=5e-5, size=len(t_pose)) for p in position]
    pose = {"stamp": START + t_pose, "x": xy[0], "y": xy[1], "z": np.ones(len(t_pose))}
    return nav, {**pose, **dict(zip(("qx", "qy", "qz", "qw"), q.T, strict=True))}


def as_flight(tmp_path: Path, blob: bytes) -> Flight:
    path = tmp_path / "flight.mcap"
    path.write_bytes(blob)
    return flysid.read(path)


def test_truth_comes_back_from_two_clocks_jitter_and_drop_outs(tmp_path: Path) -> None:
    nav, pose = simulated()
    flight = as_flight(tmp_path, bag(nav, pose, pose_clock_late_s=0.083, pose_drift_ppm=200.0))
    for channel, seed, scale in [("tilt_longitudinal", 4, 0.8), ("tilt_lateral", 5, -0.5)]:
        aligned = align([flight], "ardrone-inner", channel)
        (note,) = [
            n for f in aligned.report.flights for n in f.notes if n.startswith("clock of motion capture")
        ]
        assert "drift +" in note
        assert len(aligned.dataset.segments) == 2  # cut at the drop-out
        errors = []
        truths = []
        for s in aligned.dataset.segments:
            truth = smooth(s.time_s(aligned.dataset.dt_s) - START, seed, scale)
            errors.append(s.y[:, 0] - truth)
            truths.append(truth)
        rms = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
        assert rms < 0.01 * np.abs(np.concatenate(truths)).max()


def test_the_clock_of_motion_capture_is_found(tmp_path: Path) -> None:
    from flysid.ingest.align.clocks import align_clocks
    from flysid.ingest.align.recipe import load_recipe

    nav, pose = simulated()
    flight = as_flight(tmp_path, bag(nav, pose, pose_clock_late_s=0.083, pose_drift_ppm=200.0))
    clocks = align_clocks(load_recipe("ardrone-inner").clocks, FlightLog(flight))
    fit = clocks.fits["/optitrack/pose"][0]
    truth_s = 0.083 + 200e-6 * (fit.at_ns * 1e-9 - (START + 1.0 - 0.083))
    assert abs(fit.offset_s - truth_s) < 2e-3
    assert abs(fit.drift_ppm - 200.0) < 10.0


@pytest.mark.skipif(not (SHARED / "ardrone").is_dir(), reason="needs ../shared/logs")
def test_the_real_flight_shows_the_sign_and_no_dead_time_between_tilt_and_velocity(tmp_path: Path) -> None:
    flight = as_flight(tmp_path, bag(*read_flight(SHARED)))
    found = {s.channel: s for s in suggest([FlightLog(flight)], ["ardrone-inner"])}
    assert set(found) == {"tilt_longitudinal", "tilt_lateral"}
    for suggestion in found.values():
        assert suggestion.verdict == "closed loop"  # a position controller flew
        assert suggestion.sign == 1
        assert suggestion.feedback
        assert suggestion.delay_s is not None
        assert suggestion.delay_s < 0.06
    data = align([flight], "ardrone-inner", "tilt_longitudinal").dataset
    tilt = np.concatenate([s.u[:, 0] for s in data.segments])
    push = np.concatenate([np.gradient(s.y[:, 0], data.dt_s) for s in data.segments])
    assert float(tilt @ push / (tilt @ tilt)) == pytest.approx(np.radians(9.81), rel=0.4)  # g per degree
