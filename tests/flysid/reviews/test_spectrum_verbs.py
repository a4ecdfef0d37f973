"""`flysid spectrum` and `flysid filters` as a user meets them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.command import call
from tests.flysid.spectra.gyro_logs import BETAFLIGHT, blackbox, shaken

LOGS = Path("../shared/logs").resolve()
SAMPLE = Path("sample_logs/01-steps-seed2.tlog").resolve()
needs_logs = pytest.mark.skipif(not LOGS.exists(), reason="needs ../shared/logs")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """4 kHz before and behind a PT1 of 250 Hz; tones at 150 and 310 Hz in roll alone."""
    rate = 4000.0
    t, x = shaken(6.0, rate, [(150.0, 12.0), (310.0, 6.0)], 1.0, 31)
    _, quiet = shaken(6.0, rate, [], 1.0, 32)
    k = 2.0 * np.pi * 250.0 / rate / (2.0 * np.pi * 250.0 / rate + 1.0)
    columns = {}
    for axis, raw in enumerate((x, quiet, quiet)):
        behind = np.empty(len(raw))
        y = raw[0]
        for n, value in enumerate(raw):
            y += k * (value - y)
            behind[n] = y
        columns[f"gyroUnfilt[{axis}]"] = np.rint(10.0 * raw).astype(int).tolist()
        columns[f"gyroADC[{axis}]"] = np.rint(10.0 * behind).astype(int).tolist()
    stamps = (1_000_000 + 250 * np.arange(len(t))).tolist()
    path = tmp_path_factory.mktemp("log") / "flight.bbl"
    path.write_bytes(blackbox(BETAFLIGHT, columns, stamps))
    return path


def test_peaks_are_printed_with_interval_and_what_they_may_fold_from(log: Path) -> None:
    done = call("spectrum", log, cwd=log.parent)
    assert done.returncode == 0
    roll = done.stdout[: done.stdout.index("pitch")]
    assert "roll (main.gyroUnfilt[0])" in roll
    assert "4000 Hz (tones above 2000 Hz fold)" in " ".join(roll.split())
    assert "150 Hz [" in roll
    assert "310 Hz [" in roll
    assert "folded" not in roll  # 3,850 Hz by 8 deg/s would tear it apart
    assert "no peak above the noise" in done.stdout[len(roll) :]


def test_json_holds_spectrum_and_peaks(log: Path) -> None:
    (found,) = json.loads(call("spectrum", log, "--json", cwd=log.parent).stdout)
    roll = found["spectra"][0]
    (first, second) = roll["peaks"]
    assert first["hz"] == pytest.approx(150.0, abs=0.5)
    assert first["rms"] == pytest.approx(12.0 / np.sqrt(2.0), rel=0.05)
    assert second["hz"] == pytest.approx(310.0, abs=0.5)
    assert first["nyquist_hz"] == pytest.approx(2000.0, rel=1e-3)
    assert len(roll["hz"]) == len(roll["density"])


def test_a_plot_is_written_and_not_over_another_one(log: Path) -> None:
    done = call("spectrum", log, "--over", "time", "--plot", "a.png", cwd=log.parent)
    assert done.returncode == 0
    assert (log.parent / "a.png").stat().st_size > 10_000
    assert call("spectrum", log, "--plot", "a.png", cwd=log.parent).returncode == 2
    refused = call("spectrum", log, "--over", "rpm", "--plot", "b.png", cwd=log.parent)
    assert "does not hold the motors' RPM" in refused.stderr
    assert not (log.parent / "b.png").exists()


def test_any_field_of_any_log_and_a_misspelt_one(tmp_path: Path) -> None:
    done = call("spectrum", SAMPLE, "ATTITUDE.rollspeed", cwd=tmp_path)
    assert done.returncode == 0
    assert "50 Hz (tones above 25 Hz fold)" in " ".join(done.stdout.split())
    misspelt = call("spectrum", SAMPLE, "ATTITUDE.rolspeed", cwd=tmp_path)
    assert misspelt.returncode == 2
    assert "did you mean 'rollspeed'" in misspelt.stderr
    none = call("spectrum", SAMPLE, cwd=tmp_path)
    assert none.returncode == 1
    assert "holds no gyro" in none.stderr


def test_filters_beside_others_with_the_proof_of_the_chain(log: Path) -> None:
    done = call("filters", log, "--try", "notch 150 40", "--crossover", "20", "--json", cwd=log.parent)
    (found,) = json.loads(done.stdout)
    present, tried = found["present"], found["tried"]
    assert present["delay_ms"] == pytest.approx(1000.0 / (2.0 * np.pi * 250.0), rel=0.05)
    assert tried["noise_rms"] < 0.65 * present["noise_rms"]
    assert tried["phase_deg"] < present["phase_deg"] < 0.0
    assert all(found["replay"][axis]["error_of_removed"] < 0.06 for axis in ("roll", "pitch", "yaw"))
    assert found["crossover_hz"] == 20.0
    plain = call("filters", log, "--without", "gyro_lpf1", cwd=log.parent)
    assert plain.returncode == 0
    assert "PRESENT" in plain.stdout
    assert "misses of what it removed" in " ".join(plain.stdout.split())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--try", "notch 150"), "written 'notch HZ WIDTH'"),
        (("--try", "biqad 90"), "did you mean 'biquad'"),
        (("--try", "pt1 -5"), "is no filter"),
        (("--try", "pt1 nan"), "is no filter"),
        (("--try", "pt1 3000"), "lies above half"),
        (("--without", "gyro_lpf7"), "is on"),
        (("--crossover", "0"), "0"),
    ],
)
def test_wrong_words_are_refused_with_what_is_right(log: Path, words: tuple[str, ...], said: str) -> None:
    done = call("filters", log, *words, cwd=log.parent)
    assert done.returncode == 2
    assert said in done.stderr


def test_filters_of_an_unknown_firmware_are_refused(tmp_path: Path) -> None:
    done = call("filters", SAMPLE, cwd=tmp_path)
    assert done.returncode == 1
    assert "are not known here" in done.stderr


@pytest.mark.parametrize(
    ("setting", "cause"),
    [
        (b"looptime:125", "states looptime as 'abc', not as a number"),
        (b"looptime:125", "states 0 for looptime"),
        (b"gyro_lpf1_type:0", "states 9 for gyro_lpf1_type"),
        (b"gyro_notch_hz:0,0", "states gyro_notch_hz as '80,', not as a number"),
    ],
)
def test_a_setting_that_makes_no_sense_is_named(
    setting: bytes, cause: str, log: Path, tmp_path: Path
) -> None:
    odd = cause.split("'")[1] if "'" in cause else cause.split()[1]
    stated = b"H " + setting + b"\n"
    content = log.read_bytes()
    assert stated in content
    name = setting.partition(b":")[0]
    (tmp_path / "odd.bbl").write_bytes(content.replace(stated, b"H " + name + b":" + odd.encode() + b"\n"))
    done = call("filters", "odd.bbl", cwd=tmp_path)
    assert done.returncode == 1
    assert cause in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


@needs_logs
def test_a_chain_with_hidden_notches_states_no_noise(tmp_path: Path) -> None:
    shutil.copy(LOGS / "blackbox/btfl_002.bbl", tmp_path)
    done = call("filters", "btfl_002.bbl", cwd=tmp_path)
    assert done.returncode == 3
    assert "at least" in done.stdout
    assert "noise above" not in done.stdout
    assert "dynamic notches" in done.stdout


@needs_logs
def test_the_crossover_is_that_of_the_gains_in_the_log(tmp_path: Path) -> None:
    shutil.copy(LOGS / "blackbox/hiro_highP_highD.bfl", tmp_path)
    done = call("filters", "hiro_highP_highD.bfl", cwd=tmp_path)
    assert done.returncode == 0
    assert "of the roll loop, from the gains in the log" in " ".join(done.stdout.split())
    assert "its filters, their effect taken back" in " ".join(done.stdout.split())


@pytest.mark.parametrize(("field", "unit"), [("ATTITUDE.yaw", "deg"), ("LOCAL_POSITION_NED.vx", "m/s")])
def test_a_field_of_any_unit_has_a_spectrum(field: str, unit: str) -> None:
    assert f"{unit}, " in call("spectrum", str(SAMPLE), field, cwd=SAMPLE.parent).stdout
