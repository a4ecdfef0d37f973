"""What Betaflight 4.3, 4.4 and 4.5 write into their headers, on a flight of the firmware itself."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from flysid.cli.gains import command as gains
from flysid.cli.predict import command as predict
from flysid.loops.betaflight import BetaflightLaw
from flysid.loops.judged import sets_of_gains
from flysid.loops.new_settings import value_of, with_settings
from tests.flysid.loops.test_loops import log_of

D_FIRST = {"rollPID": "45,80,40", "pitchPID": "47,84,46", "d_max": None, "d_min": "30,34,0"}
"""Up to 4.5 the gains have the most of D, and another line its least."""
SILENT = dict.fromkeys(
    ("gyro_lpf1_dyn_expo", "dterm_lpf1_dyn_expo", "tpa_low_rate", "tpa_low_breakpoint", "tpa_low_always")
)
DIALECTS: Mapping[str, Mapping[str, str | None]] = {
    "4.5.1": D_FIRST | {"iterm_windup": "85"},
    "4.4.2": D_FIRST | SILENT | {"iterm_windup": "85"},
    "4.3.2": D_FIRST | SILENT | {"iterm_windup": "85", "anti_gravity_gain": "3500", "anti_gravity_mode": "0"},
}


def in_dialect(log: Path, folder: Path, version: str) -> Path:
    """A copy whose header is the one that a version writes of the same settings; None leaves a line out."""
    lines = {**DIALECTS[version], "Firmware revision": f"Betaflight {version} (77d01ba3b) STM32F7X2"}
    content = log.read_bytes()
    for name, value in lines.items():
        new = f"H {name}:{value}\n".encode() if value is not None else b""
        content, found = re.subn(rb"^H %b:.*\n" % name.encode(), new, content, count=1, flags=re.MULTILINE)
        if not found:
            content = content.replace(b"H looptime:", new + b"H looptime:", 1)
    copy = folder / f"{version}.bbl"
    copy.write_bytes(content)
    return copy


def header_of(log: Path) -> str:
    """Its lines, from the first bytes of a log."""
    return log.read_bytes()[:20_000].decode("latin-1")


def ran(command: object, *words: str) -> Result:
    done = CliRunner().invoke(command, list(words), standalone_mode=False)  # type: ignore[arg-type]
    assert done.exception is None, done.exception
    return done


def stated_in(version: str) -> dict[str, str]:
    """A whole header of a version, whose settings are those of every other one here."""
    common = {"Firmware revision": f"Betaflight {version} (77d01ba3b) X", "dterm_lpf1_static_hz": "75"}
    common |= {"dterm_lpf1_dyn_hz": "75,150", "dterm_lpf2_static_hz": "150", "ff_weight": "120,125,120"}
    common |= {"yawPID": "45,80,0", "d_max_gain": "37", "d_max_advance": "20", "looptime": "125"}
    if version == "4.6.0":
        return common | {"rollPID": "45,80,30", "d_max": "40,46,0"}
    return common | {name: value for name, value in DIALECTS[version].items() if value is not None}


@pytest.mark.parametrize("version", DIALECTS)
def test_d_grows_as_theheader_of_its_version_states(version: str) -> None:
    """`d_max_gain` was looked for under its name of 4.2: D never grew with quick motions."""
    found, newest = (BetaflightLaw.of(stated_in(own), "roll") for own in (version, "4.6.0"))
    assert found.boost is not None
    assert found.boost.by_rate > 0.0
    assert (found.boost, found.d, found.filters, found.moving) == (
        newest.boost,
        newest.d,
        newest.filters,
        newest.moving,
    )


def test_the_law_of_4_5_gives_the_terms_of_a_flight_under_its_header(
    firmware_log: Path, tmp_path: Path
) -> None:
    log = in_dialect(firmware_log, tmp_path, "4.5.1")
    (found,) = json.loads(ran(gains, str(log), "--axis", "roll", "--json").stdout)
    assert found["refused"] is None
    assert found["law"] == "Betaflight 4.5"
    assert max(term["miss"] for term in found["terms"]) < 0.08


def test_a_setting_is_found_by_the_name_that_the_command_line_of_its_version_has() -> None:
    four_two = {"Firmware revision": "Betaflight 4.2.9 (e097f4ab7) X", "d_min_gain": "37"}
    four_two |= {"dterm_filter_type": "0", "dterm_filter2_type": "1"}
    assert value_of(four_two, "d_min_boost_gain") == 37.0
    assert with_settings(four_two, {"dterm_lowpass_type": "BIQUAD"})["dterm_filter_type"] == "1"
    four_five = {"Firmware revision": "Betaflight 4.5.1 (77d01ba3b) X", "d_max_gain": "37"}
    assert value_of(four_five, "d_max_gain") == 37.0


def test_flights_with_other_d_filters_are_two_sets() -> None:
    """Only lines of 3.x and INAV were compared: since 4.3 other filters were judged as one set."""
    new = {"Firmware revision": "Betaflight 4.5.1 (77d01ba3b) X", "d_min": "0,0,0"}
    logs = [log_of(1.0, new | {"dterm_lpf1_static_hz": hz}) for hz in ("75", "150")]
    assert sets_of_gains(logs, ["roll"]) == 2
    assert sets_of_gains([logs[0], logs[0]], ["roll"]) == 1


def test_what_a_law_leaves_out_is_named_with_the_term_that_misses(firmware_log: Path, tmp_path: Path) -> None:
    copy = tmp_path / "log.bbl"
    content = firmware_log.read_bytes()
    for old, new in ((b"H rollPID:45,80,30\n", b"H rollPID:60,80,30\n"), (b"gain:0\n", b"gain:9\n")):
        assert old in content
        content = content.replace(old, new, 1)
    copy.write_bytes(content)
    said = " ".join(ran(gains, str(copy), "--axis", "roll").stdout.split())
    assert "the P term is 33 % off (the log has absolute control (abs_control_gain)" in said


def test_a_line_that_the_header_lost_is_named_with_the_term_that_misses(
    firmware_log: Path, tmp_path: Path
) -> None:
    log = in_dialect(firmware_log, tmp_path, "4.5.1")
    content = log.read_bytes().replace(b"H d_min:30,34,0\n", b"", 1)
    log.write_bytes(content.replace(b"H rollPID:45,80,40\n", b"H rollPID:45,80,60\n", 1))
    said = " ".join(ran(gains, str(log), "--axis", "roll").stdout.split())
    assert re.search(r"the D term is \d+ % off \(the log's header does not state d_min\)", said)


@pytest.mark.parametrize("version", DIALECTS)
def test_a_wholeheader_of_a_version_lacks_nothing(firmware_log: Path, tmp_path: Path, version: str) -> None:
    settings = dict(
        re.findall(r"^H ([^:\n]+):(.*)$", header_of(in_dialect(firmware_log, tmp_path, version)), re.M)
    )
    assert not any(BetaflightLaw.of(settings, "roll").not_stated.values())


def test_an_adjustment_that_the_log_itself_states_is_named(firmware_log: Path, tmp_path: Path) -> None:
    """Roll's P is function 18, and 90 stands for 45 as the format writes numbers with a sign."""
    copy = tmp_path / "log.bbl"
    header, ends = b"H rollPID:45,80,30\n", b"E\xffEnd of log"
    content = firmware_log.read_bytes()
    assert content.count(header) == content.count(ends) == 1
    content = content.replace(header, b"H rollPID:60,80,30\n")
    copy.write_bytes(content.replace(ends, b"E" + bytes([13, 18, 90]) + ends))
    said = " ".join(ran(gains, str(copy), "--axis", "roll").stdout.split())
    assert re.search(r"P term is 33 % off \(an adjustment in flight set its gain to 45 at \d\d s\)", said)


def test_integrated_yaw_is_no_law_that_is_known() -> None:
    law = BetaflightLaw.of(stated_in("4.5.1") | {"use_integrated_yaw": "1"}, "yaw")
    assert law.not_described == ("integrated yaw (use_integrated_yaw)",)


LOW = {"tpa_rate": "65", "tpa_breakpoint": "1750", "tpa_low_rate": "60", "tpa_low_breakpoint": "1700"}


def test_tpa_below_a_throttle_counts_where_it_stays_on() -> None:
    """On a flight of 4.6 with `tpa_low_always` P was 14 % off and D too; now 0.3 and 0.05 %."""
    throttle = np.array([1000.0, 1350.0, 1700.0, 1750.0, 2000.0])
    for version in ("4.5.1", "4.6.0"):
        stated = stated_in(version) | LOW
        on = BetaflightLaw.of(stated | {"tpa_low_always": "1"}, "roll").kept(throttle)
        off = BetaflightLaw.of(stated | {"tpa_low_always": "0"}, "roll").kept(throttle)
        assert on == pytest.approx([0.4, 0.7, 1.0, 1.0, 0.35])
        assert off == pytest.approx([1.0, 1.0, 1.0, 1.0, 0.35])  # gone before the flight
    capped = BetaflightLaw.of(stated | {"tpa_low_always": "1", "tpa_breakpoint": "1350"}, "roll")
    assert capped.kept(throttle)[:2] == pytest.approx([0.4, 1.0])


def test_low_tpa_is_a_setting_to_predict_with(firmware_log: Path) -> None:
    """The flight hovered at 1590 us: with it on, P and D are 60 % * 110 / 700 = 9 % lower."""
    crossovers = []
    for always in ("OFF", "ON"):
        words = ",".join(f"{name}={value}" for name, value in LOW.items())
        new = f"{words},tpa_mode=0,tpa_low_always={always}"
        shown = ran(predict, str(firmware_log), "--axis", "roll", "--set", new).stdout
        found = re.search(r"crossover [\d.]+ Hz \[[^]]+\] -> ([\d.]+) Hz", shown)
        assert found is not None
        crossovers.append(float(found[1]))
    assert crossovers[1] < crossovers[0] - 0.1


def test_the_hyperbolic_curve_of_tpa_is_no_law_that_is_known() -> None:
    law = BetaflightLaw.of(stated_in("4.6.0") | {"tpa_curve_type": "1"}, "roll")
    assert law.not_described == ("the hyperbolic curve of TPA (tpa_curve_type)",)
