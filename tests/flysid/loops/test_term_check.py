"""The law of a firmware against the terms that its logs recorded, and what is named where one is off."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from flysid.cli.gains import command

LOGS = Path("../shared/logs/blackbox")
real = pytest.mark.skipif(not LOGS.is_dir(), reason="no real logs here")


def judged(log: Path, *axes: str) -> list[dict[str, Any]]:
    """What `flysid gains --json` prints of a log."""
    words = [word for axis in axes for word in ("--axis", axis)]
    done = CliRunner().invoke(command, [str(log), *words, "--json"], standalone_mode=False)
    assert done.exception is None
    found: list[dict[str, Any]] = json.loads(done.stdout)
    return found


def printed(log: Path, axis: str) -> str:
    """What it prints for people, in one line."""
    done = CliRunner().invoke(command, [str(log), "--axis", axis], standalone_mode=False)
    assert done.exception is None
    return " ".join(done.stdout.split())


def misses(found: dict[str, Any]) -> dict[str, float]:
    return {term["term"]: term["miss"] for term in found["terms"]}


def patched(log: Path, folder: Path, **lines: tuple[str, str]) -> Path:
    """A copy whose header states other settings, of as many letters."""
    content = log.read_bytes()
    for name, (old, new) in lines.items():
        before, after = (f"H {name}:{value}\n".encode() for value in (old, new))
        assert before in content
        assert len(before) == len(after)
        content = content.replace(before, after)
    copy = folder / log.name
    copy.write_bytes(content)
    return copy


def test_the_law_of_4_6_gives_what_the_firmware_itself_recorded(firmware_log: Path) -> None:
    for found in judged(firmware_log, "roll", "pitch"):
        assert found["law"] == "Betaflight 4.6"
        assert misses(found).keys() == {"P", "I", "D"}
        assert max(misses(found).values()) < 0.08
        assert found["controller_miss"] < 0.15
        assert found["figures"]["phase_deg"]["low"] > 20.0


def test_a_gain_that_was_not_flown_is_named_by_its_term(firmware_log: Path, tmp_path: Path) -> None:
    other = patched(firmware_log, tmp_path, rollPID=("45,80,30", "60,80,30"))
    (found,) = judged(other, "roll")
    assert found["refused"] is not None
    assert "the P term is 33 % off (recorded over rebuilt is 0.75" in found["refused"]
    assert "the D term" not in found["refused"]


@real
def test_the_law_of_4_2_gives_what_a_real_log_recorded() -> None:
    for found in judged(LOGS / "btfl_002.bbl", "roll", "pitch"):
        assert found["law"] == "Betaflight 4.2"
        assert max(misses(found).values()) < 0.14
    assert "Betaflight 4.2, term by term: P" in printed(LOGS / "btfl_002.bbl", "roll")


@real
@pytest.mark.parametrize(
    ("lines", "term", "cause"),
    [
        ({"dterm_lowpass_dyn_hz": ("70,170", "10,020")}, "D", ""),
        ({"d_min": ("23,25,0", "00,00,0")}, "D", ""),
        ({"pitchPID": ("49,90,40", "70,90,40")}, "P", ""),
        ({"iterm_relax_cutoff": ("15", "02")}, "I", "without iterm_relax"),
    ],
    ids=["moving low-pass", "least D", "P", "relax"],
)
def test_the_term_that_misses_is_named(
    lines: dict[str, tuple[str, str]], term: str, cause: str, tmp_path: Path
) -> None:
    log = patched(LOGS / "btfl_002.bbl", tmp_path, **lines)
    (found,) = judged(log, "pitch")
    bad = {own["term"]: own["cause"] for own in found["terms"] if not own["fits"]}
    assert list(bad) == [term]
    assert bad[term].startswith(cause)


@real
def test_yaw_of_3_x_has_no_derivative_and_a_limit_of_its_setpoint() -> None:
    """Its rebuilt D was compared with a term that the firmware does not have: 68 % off."""
    (found,) = judged(LOGS / "greenreaper_flight15.bfl", "yaw")
    assert found["refused"] is None
    assert found["controller_miss"] < 0.12
    assert misses(found)["P"] < 0.06


@real
def test_the_integral_of_3_4_turns_with_the_body() -> None:
    (found,) = judged(LOGS / "greenreaper_flight15.bfl", "yaw")
    assert misses(found)["I"] < 0.2
