"""Rate loops of PX4 and ArduPilot, whose truth is known, read from logs as they keep them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli.gains import command
from flysid.errors import UsageError
from flysid.loops.controller import Controller
from flysid.loops.judged import judge
from flysid.loops.parameter_laws import ardupilot, px4
from flysid.loops.parameterlogs import px4_parameters
from flysid.validate.runs import run
from flysid.validate.runs.run import RUN_FILE
from tests.flysid.loops.autopilots import ARDUPILOT, PX4, Log, ardupilot_log, px4_log
from tests.flysid.loops.simulated import Vehicle, truth

LOGS = Path("../shared/logs")
VEHICLE = Vehicle(12.0, 0.04, 8)
LAWS: dict[str, tuple[Callable[..., Log], Controller]] = {
    "px4": (
        px4_log,
        px4({f"MC_ROLLRATE_{k}": v for k, v in PX4.items()} | {"IMU_DGYRO_CUTOFF": 30.0}, "roll"),
    ),
    "ardupilot": (ardupilot_log, ardupilot({f"ATC_RAT_RLL_{k}": v for k, v in ARDUPILOT.items()}, "roll")),
}
TRUE = replace(VEHICLE, delay_steps=9)
"""A step of the simulation is half a step late."""


@pytest.mark.parametrize("kind", list(LAWS))
@pytest.mark.parametrize("outer", [0.0, 6.5])
def test_a_known_loop_is_found_in_rate_and_in_angle_modes(kind: str, outer: float) -> None:
    log, law = LAWS[kind]
    found = judge([log(90.0, 3, vehicle=VEHICLE, outer=outer)], ["roll"])[0]
    assert found.margins is not None, found.refused
    true = truth(TRUE, law)
    assert found.miss < 0.05
    assert found.margins.crossover_hz.value == pytest.approx(true["crossover_hz"], abs=0.15)
    assert found.margins.phase_deg.value == pytest.approx(true["phase_deg"], abs=2.5)
    assert found.margins.ms.value == pytest.approx(true["ms"], abs=0.05)


def test_gusts_that_come_back_through_an_angle_loop_bend_no_margin() -> None:
    true = truth(TRUE, LAWS["px4"][1])["phase_deg"]
    gusty: dict[str, Any] = {"vehicle": VEHICLE, "outer": 6.5, "stick": 30.0, "disturbance": 60.0}
    phases = []
    for seed in range(4):
        margins = judge([px4_log(90.0, seed, **gusty)], ["roll"])[0].margins
        assert margins is not None
        phases.append(margins.phase_deg.value)
    assert np.mean(np.asarray(phases, dtype=float)) == pytest.approx(true, abs=5.0)
    log = px4_log(90.0, 0, **gusty)
    log.tables["vehicle_attitude_setpoint"]["q_d"] = [[1.0, 0.0, 0.0, 0.0]] * len(
        log.tables["vehicle_attitude_setpoint"]["q_d"]
    )  # as if the rates were asked for by hand
    blind = judge([log], ["roll"])[0].margins
    assert blind is not None
    assert blind.phase_deg.value is not None
    assert blind.phase_deg.value < true - 10.0


def test_flights_of_other_gains_are_judged_apart() -> None:
    logs: list[Any] = [px4_log(30.0, s, vehicle=VEHICLE) for s in (1, 2)]
    logs.append(px4_log(30.0, 3, {"MC_ROLLRATE_I": 0.3}, vehicle=VEHICLE))
    assert [len(j.flights) for j in judge(logs, ["roll"])] == [2, 1]


@pytest.mark.skipif(not LOGS.is_dir(), reason="no real logs here")
@pytest.mark.parametrize(
    ("log", "words"),
    [
        ("ulog/quad_stabilised_92s.ulg", "MC_ROLLRATE_K 1, P 0.15, I 0.2, D 0.003"),
        ("ulog/pyulog_sample.ulg", "does not state MC_ROLLRATE_K"),
        ("dataflash/sitl_copter_49s.BIN", "too slow to see"),
        ("dataflash/copter_437s.bin", "before 4.0, with a single filter"),
    ],
)
def test_real_logs_are_judged_or_refused(log: str, words: str) -> None:
    done = CliRunner().invoke(command, [str(LOGS / log), "--axis", "roll"], standalone_mode=False)
    assert done.exception is None
    assert words in done.stdout


def test_the_filter_of_px4s_derivative_depends_on_the_release() -> None:
    stated = {f"MC_ROLLRATE_{k}": v for k, v in PX4.items()} | {"IMU_DGYRO_CUTOFF": 30.0}
    assert px4(stated, "roll").filters == ((1, 30.0),)
    log = px4_log(40.0)
    log.info["ver_sw_release"] = str(0x010F0080)
    assert px4(px4_parameters(log), "roll").filters == ((1, 30.0),)
    log.info["ver_sw_release"] = str(0x010C03FF)
    assert px4(px4_parameters(log), "roll").filters == ((2, 30.0),)


def test_the_data_of_a_run_may_be_at_an_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / RUN_FILE).write_text("{}")
    found = SimpleNamespace(data="s3://lake", flights=("a",), skipped={})
    monkeypatch.setattr(run, "open_run", lambda _: found)
    mirrors = {"s3://lake": tmp_path / "mirror"}
    monkeypatch.setattr("flysid.cli.gains.here", mirrors.__getitem__)
    with pytest.raises(UsageError) as caught:
        CliRunner().invoke(command, [str(tmp_path)], catch_exceptions=False)
    assert caught.value.path == str(tmp_path / "mirror")
