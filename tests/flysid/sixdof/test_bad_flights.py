"""Bad input of `flysid vehicle`: the cause is named, and no number is invented."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from flysid.cli import root
from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError
from flysid.sixdof.records import flights_of
from flysid.sixdof.vehicle import _Work
from tests.flysid.sixdof.hidden_quad import LOGGED_S, SIGNALS

Change = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
GYRO, FORCE = slice(0, 3), slice(3, 6)


@pytest.fixture(autouse=True)
def _regression_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Free runs take ten times as long, and refuse nothing."""
    monkeypatch.setattr(_Work, "shoot", lambda _: None)


def written(path: Path, still: Dataset, change: Change) -> Path:
    segment = still.segments[0].slice(0, 1200, still.dt_s)
    u, y = change(segment.u.copy(), segment.y.copy())
    names = ["time", *(f"motor{i + 1}" for i in range(u.shape[1])), *SIGNALS]
    table = np.column_stack([LOGGED_S * np.arange(len(u)), u, y])
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.8g")
    return path


def fit(*paths: Path) -> Result:
    return CliRunner().invoke(root, ["vehicle", "--no-judge", "--pool", *map(str, paths)])


def words_of(done: Result) -> str:
    assert done.exit_code == 0, done.output
    return " ".join(done.stdout.split())


def put(columns: slice, factor: float) -> Change:
    def change(u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        y[:, columns] *= factor
        return u, y

    return change


def stand(u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """On the ground: gravity and noise."""
    noise = np.random.default_rng(1).standard_normal(y.shape)
    spread = np.repeat([0.01, 0.05, 0.0, 0.002], [3, 3, 4, 6])
    return 0.3 * u, spread * noise + [0.0, 0.0, 0.0, 0.0, 0.0, 9.81, 1.0, *[0.0] * 9]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (put(GYRO, float(np.degrees(1.0))), "57 times as fast as the attitude, as one in deg/s"),
        (put(GYRO, 0.0), "the gyro never changes"),
        (put(FORCE, 1.0 / 9.81), "as one in g does"),
        (put(FORCE, 1000.0 / 9.81), "as one in cm/s^2 or mg does"),
        (put(GYRO, 1000.0), "as one in mrad/s does"),
        (lambda u, y: (1.0 - u, y), "the more these motors are commanded the less they lift"),
        (stand, "nothing flies"),
    ],
)
def test_a_wrong_unit_or_sign_is_named(still: Dataset, tmp_path: Path, change: Change, words: str) -> None:
    done = fit(written(tmp_path / "bad.csv", still, change))
    assert isinstance(done.exception, DataError), done.output
    assert words in str(done.exception)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda u, y: (u[:, :3], y), "a motor is not logged, or one of these outputs is no motor"),
        (lambda u, y: (np.repeat(u[::10], 10, axis=0), y), "slower than motors follow"),
        (lambda u, y: (np.hstack([u, u]), y), "motors 1 and 5 are commanded alike"),
        (lambda u, y: (np.clip(1.6 * u, 0.0, 1.0), y), "it gave no more, whatever was demanded"),
    ],
)
def test_what_such_commands_cannot_tell_is_named(
    still: Dataset, tmp_path: Path, change: Change, words: str
) -> None:
    assert words in words_of(fit(written(tmp_path / "bad.csv", still, change)))


def test_a_bad_flight_beside_a_good_one_is_left_out_and_named(still: Dataset, tmp_path: Path) -> None:
    good = written(tmp_path / "good.csv", still, lambda u, y: (u, y))
    bad = written(tmp_path / "ground.csv", still, stand)
    said = words_of(fit(good, bad))
    assert "no whole second in the air, so it tells nothing" in said
    six = written(tmp_path / "six.csv", still, lambda u, y: (np.hstack([u, u[:, :2]]), y))
    apart = fit(good, six)
    assert isinstance(apart.exception, DataError)
    assert "motor5 turns in six" in str(apart.exception)


def test_a_motor_with_a_gap_stays_a_motor(still: Dataset, tmp_path: Path) -> None:
    def change(u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        u[300:500, 1] = np.nan
        return u, y

    assert "vehicle with 4 motors" in words_of(fit(written(tmp_path / "gap.csv", still, change)))


def test_axes_that_do_not_fit_the_gyro_are_named(still: Dataset, tmp_path: Path) -> None:
    def change(u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        y[:, GYRO] = y[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
        return u, y

    said = words_of(fit(written(tmp_path / "axes.csv", still, change)))
    assert "gyro and attitude hardly turn alike" in said


@pytest.mark.parametrize(
    "kept", [("time", "motor", "gyro", "acc"), ("time", "motor", "gyro", "acc", "q", "v")]
)
def test_a_ground_flight_without_positions_has_no_thrust(
    still: Dataset, tmp_path: Path, kept: tuple[str, ...]
) -> None:
    table = written(tmp_path / "ground.csv", still, stand)
    lines = [line.split(",") for line in table.read_text("utf-8").splitlines()]
    columns = [i for i, name in enumerate(lines[0]) if name.startswith(kept)]
    table.write_text("\n".join(",".join(line[i] for i in columns) for line in lines), "utf-8")
    said = words_of(fit(table))
    assert "nothing that turns follows these motors: on the ground" in said
    assert "thrust of a motor " not in said.partition("not determined")[0]
    assert "velocities are" not in said


@pytest.mark.parametrize(
    ("order", "signs", "words"),
    [
        ([0, 1, 2], [1.0, -1.0, -1.0], "x, y, z are its x, -y, -z"),
        ([1, 0, 2], [1.0, -1.0, 1.0], "x, y, z are its -y, x, z"),
        ([2, 1, 0], [-1.0, 1.0, 1.0], "x, y, z are its z, y, -x"),
    ],
)
def test_axes_of_an_accelerometer_are_found(
    still: Dataset, order: list[int], signs: list[float], words: str
) -> None:
    y = still.segments[0].y.copy()
    y[:, FORCE] = y[:, FORCE][:, order] * signs
    (said,) = flights_of(still.with_segments([replace(still.segments[0], y=y)])).frames
    assert words in said


def test_commands_of_dshot_are_no_pulses(still: Dataset, tmp_path: Path) -> None:
    table = written(tmp_path / "dshot.csv", still, lambda u, y: (np.round(48.0 + 1999.0 * u), y))
    assert "shares: 48 stops, 2047 is full scale" in words_of(fit(table))
