"""What INAV 6, 7 and 8 write into their headers, on one flight, through the command line."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from flysid.cli.design import command as design
from flysid.cli.filters import command as filters
from flysid.cli.gains import command as gains
from flysid.cli.predict import command as predict
from flysid.cli.review import command as review
from flysid.errors import DataError
from flysid.loops.new_settings import read_settings
from flysid.spectra.inav import inav_chain
from flysid.spectra.stages import Kind
from tests.flysid.loops.test_inav import HEADER, inav_log
from tests.flysid.spectra.gyro_logs import blackbox

FIELDS = {"axisRate": 3, "axisP": 3, "axisI": 3, "axisD": 3, "axisF": 3, "gyroADC": 3, "gyroRaw": 3} | {
    "rcCommand": 4,
    "motor": 4,
}
COMMON = HEADER | {
    "Firmware type": "Cleanflight",
    "minthrottle": "1100",
    "motorOutput": "1100,2000",
    "gyro_scale": "0x3f800000",
    "acc_1G": "2048",
    "vbatref": "1640",
    "gyro_lpf": "0",
    "gyro_lpf_hz": "110",
    "dynamicGyroNotchQ": "250",
    "dynamicGyroNotchMinHz": "80",
    "axisAccelerationLimitYaw": "10000",
    "axisAccelerationLimitRollPitch": "0",
    "rpm_gyro_filter_enabled": "0",
    "rpm_gyro_harmonics": "1",
    "features": "0",
}
DIALECTS: Mapping[str, Mapping[str, str]] = {
    "6.1.1": {"dterm_lpf2_hz": "0", "dterm_lpf2_type": "0"},
    "7.1.2": {},
    "8.0.1": {},
}


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """The flight under the header of each version."""
    main = inav_log().tables["main"]
    count = len(main["time_ns"])
    names = [f"{field}[{k}]" for field, size in FIELDS.items() for k in range(size)]
    columns = {name: np.asarray(main.get(name, np.zeros(count)), dtype=np.int64) for name in names}
    columns |= {f"motor[{k}]": np.full(count, 1500) for k in range(4)}
    columns |= {"gyroRaw[0]": columns["gyroADC[0]"]}
    folder = tmp_path_factory.mktemp("inav")
    settings = {name: value for name, value in COMMON.items() if name != "pid_process_denom"}
    content = blackbox(settings, columns, main["time_ns"] // 1000)  # type: ignore[arg-type]
    found = {}
    for version, more in DIALECTS.items():
        lines = "".join(f"H {name}:{value}\n" for name, value in more.items()).encode()
        own = content.replace(b"INAV 7.1.2", f"INAV {version}".encode(), 1)
        own = own.replace(b"H looptime:", lines + b"H looptime:", 1)
        found[version] = folder / f"inav_{version}.bbl"
        found[version].write_bytes(own)
    return found


def ran(command: object, *words: str) -> Result:
    done = CliRunner().invoke(command, list(words), standalone_mode=False)  # type: ignore[arg-type]
    assert done.exception is None, done.exception
    return done


@pytest.mark.parametrize("version", DIALECTS)
def test_gains_predict_and_design_know_the_header(
    flown: Mapping[str, Path], tmp_path: Path, version: str
) -> None:
    log, of_roll = str(flown[version]), ("--axis", "roll")
    (judged,) = json.loads(ran(gains, log, *of_roll, "--json").stdout)
    assert judged["refused"] is None
    assert judged["law"] == f"INAV {version[:3]}"
    assert max(term["miss"] for term in judged["terms"]) < 0.08
    other = ran(predict, log, *of_roll, "--set", "mc_p_roll=60,dterm_lpf_hz=90").stdout
    assert "rollPID P 40 -> 60" in other
    ran(design, log, *of_roll, "-o", str(tmp_path / "design"))
    new = read_settings(tmp_path / "design" / "new.txt")
    assert new
    assert new.keys() <= {"mc_p_roll", "mc_i_roll", "mc_d_roll", "dterm_lpf_hz"}


@pytest.mark.parametrize(
    ("version", "left_out"),
    [("6.1.1", "gyro_main_lpf_type"), ("7.1.2", "gyro_use_dyn_lpf"), ("8.0.1", "gyro_filter_mode")],
)
def test_filters_and_review_count_what_the_header_states_and_name_what_it_does_not(
    flown: Mapping[str, Path], version: str, left_out: str
) -> None:
    log = str(flown[version])
    shown = " ".join(ran(filters, log, "--crossover", "10").stdout.split())
    assert "gyro_main_lpf_hz pt1 110 Hz on" in shown
    assert re.search(r"delay at 10 Hz at least 1\.4\d ms", shown)  # 1 / (2 pi 110 Hz)
    assert left_out in shown
    assert "`diff all`" in shown
    assert "gyro_hardware_lpf" not in shown
    delay = json.loads(ran(review, log, "--json").stdout)["sections"]["vibration"]["facts"]["filter_delay"]
    assert delay["value"] == pytest.approx(1.44, abs=0.01)
    assert left_out in delay["note"]


def test_rpm_notches_and_lost_lines_of_inav_are_named() -> None:
    chain = inav_chain(COMMON | {"rpm_gyro_filter_enabled": "1", "rpm_gyro_harmonics": "2"}, 1.0)
    assert chain.unknown[0] == "2 RPM notches for each motor: the log does not hold the motors' RPM"
    assert not inav_chain(COMMON | {"gyro_lpf_hz": "0"}, 1.0).steps
    for line in ("gyro_lpf_hz", "looptime"):
        with pytest.raises(DataError, match=f"does not state {line}"):
            inav_chain({name: value for name, value in COMMON.items() if name != line}, 1.0)


def test_a_version_without_described_filters_is_refused_and_a_newer_one_is_named() -> None:
    with pytest.raises(DataError, match=r"gyro filters of INAV 5\.1 are not known here"):
        inav_chain(COMMON | {"Firmware revision": "INAV 5.1.0 (8ae2c5b) X"}, 1.0)
    newer = inav_chain(COMMON | {"Firmware revision": "INAV 9.1.0 (e519b69) X"}, 1.0)
    assert newer.unknown[0] == "INAV 9.1, which is not described: the law of 8.0 stands in"
    assert newer.steps[0].stage.kind is Kind.PT1


def test_a_slow_loop_moves_the_edge() -> None:
    (step,) = inav_chain(COMMON, 1.25).steps
    assert step.stage.hz == pytest.approx(88.0)
    assert step.rate_hz == pytest.approx(800.0)
