"""Chains from parameters: what each of them stands for, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from flysid.errors import DataError
from flysid.reviews.logged import Column
from flysid.spectra.ardupilot import Sources, ardupilot_chain
from flysid.spectra.betaflight import betaflight_chain, throttle_in_force
from flysid.spectra.chain import Chain
from flysid.spectra.px4 import px4_chain
from tests.flysid.spectra.gyro_logs import BETAFLIGHT

TIME = np.asarray(np.linspace(0.0, 10.0, 1001), dtype=np.float64)


def column(values: float | np.ndarray) -> Column:
    return Column("test", "", TIME, np.asarray(values * np.ones(len(TIME)), dtype=np.float64))


def gain(chain: Chain, hz: float) -> float:
    return float(np.abs(chain.response(np.array([hz])))[0])


def test_old_names_of_betaflight_mean_the_same() -> None:
    new = betaflight_chain(BETAFLIGHT | {"gyro_lpf2_static_hz": "400"}, 1.0)
    old = {
        "Firmware revision": "Betaflight 3.4.0 (a5ba01666) OMNIBUSF4SD",
        "looptime": "125",
        "pid_process_denom": "4",
        "gyro_lowpass_type": "0",
        "gyro_lowpass_hz": "250",
        "gyro_lowpass2_type": "0",
        "gyro_lowpass2_hz": "400",
        "gyro_notch_hz": "0,0",
        "gyro_notch_cutoff": "0,0",
        "features": "0",
    }
    found = betaflight_chain(old, 1.0)
    assert found.fastest_hz == 8000.0
    assert all(step.rate_hz == 8000.0 for step in found.steps)  # before 4.2 all ran with every sample
    assert found.delay_s(10.0) == pytest.approx(new.delay_s(10.0), rel=0.1)
    with pytest.raises(DataError, match="are not known here"):
        betaflight_chain(old | {"Firmware revision": "INAV 7.1.0 (abc) MATEKF405"}, 1.0)


@pytest.mark.parametrize("line", ["gyro_lpf1_static_hz", "gyro_lpf2_static_hz", "gyro_notch_hz"])
def test_a_filter_whose_line_is_lost_is_named(line: str) -> None:
    """The chain counted as whole without it."""
    whole = {name: value for name, value in BETAFLIGHT.items() if name != "gyro_lpf1_dyn_hz"}
    assert not betaflight_chain(whole, 1.0).unknown
    (found,) = betaflight_chain({name: whole[name] for name in whole if name != line}, 1.0).unknown
    assert found.endswith(f"does not state {line}")


def test_the_dynamic_low_pass_of_4_2_has_another_curve() -> None:
    throttle = column(0.5)
    new = betaflight_chain(
        BETAFLIGHT | {"gyro_lpf1_dyn_hz": "200,500", "gyro_lpf1_dyn_expo": "5"}, 1.0, throttle
    )
    four_two = {
        **BETAFLIGHT,
        "Firmware revision": "Betaflight 4.2.9 (e097f4ab7) STM32F7X2",
        "gyro_lowpass_dyn_hz": "200,500",
        "gyro_lpf1_dyn_hz": "",
    }
    old = betaflight_chain(four_two, 1.0, throttle)
    assert float(np.max(new.steps[0].stage.hz)) == pytest.approx(200.0 + 300.0 * (0.5 * 0.5 * 0.5 + 0.5))
    assert float(np.max(old.steps[0].stage.hz)) == np.floor(0.5 * (1.0 - 0.25 / 3.0) * 1.5 * 500.0)
    assert "does not hold the throttle" in betaflight_chain(four_two, 1.0).unknown[0]


def test_dynamic_notches_go_by_their_count_since_4_3() -> None:
    """The switch in `features` is gone since then: a log that had them counted as one without."""
    stated = BETAFLIGHT | {"pid_process_denom": "1", "dyn_notch_count": "3"}

    def of(version: str, **more: str) -> bool:
        settings = stated | {"Firmware revision": f"Betaflight {version} (77d01ba3b) X"} | more
        return bool(betaflight_chain(settings, 1.0).unknown)

    assert of("4.3.2")
    assert of("4.5.1")
    assert not of("4.5.1", dyn_notch_count="0")
    assert not of("4.5.1", pid_process_denom="8")  # a loop of 1 kHz is too slow for them
    assert not of("4.2.9")
    assert of("4.2.9", features=str(1 << 29))


def test_headers_before_4_6_leave_the_expo_of_the_dynamic_low_pass_out() -> None:
    stated = BETAFLIGHT | {"gyro_lpf1_dyn_hz": "200,500"}
    silent = betaflight_chain({k: v for k, v in stated.items() if "expo" not in k}, 1.0, column(0.5))
    said = betaflight_chain(stated | {"gyro_lpf1_dyn_expo": "5"}, 1.0, column(0.5))
    assert np.max(silent.steps[0].stage.hz) == np.max(said.steps[0].stage.hz)


def test_the_throttle_moves_the_filter_in_steps_that_are_held() -> None:
    time_s = np.asarray(np.arange(100) * 0.001, dtype=np.float64)
    found = throttle_in_force(time_s, np.asarray(0.30 + 0.01 * np.arange(100) * 0.5, dtype=np.float64))
    changes = np.flatnonzero(np.diff(found))
    assert np.diff(changes).min() >= 5  # one step a 2 ms, held for 5 ms
    np.testing.assert_allclose(found, np.round(found, 2))
    assert found[0] == 0.30


def test_px4s_parameters() -> None:
    stated = {
        "IMU_GYRO_CUTOFF": 40.0,
        "IMU_GYRO_NF0_FRQ": 120.0,
        "IMU_GYRO_NF0_BW": 20.0,
        "IMU_GYRO_NF1_FRQ": 0.0,
    }
    chain = px4_chain(stated, 2000.0)
    assert gain(chain, 120.0) < 1e-6
    assert gain(chain, 40.0) == pytest.approx(np.sqrt(0.5), rel=0.02)
    assert chain.delay_s(10.0) > px4_chain({"IMU_GYRO_CUTOFF": 40.0}, 2000.0).delay_s(10.0)
    assert not px4_chain({"IMU_GYRO_CUTOFF": 0.0}, 2000.0).steps
    dynamic = px4_chain(stated | {"IMU_GYRO_DNF_EN": 3.0}, 2000.0)
    assert len(dynamic.unknown) == 2
    motors = [column(90.0), column(95.0)]
    esc = px4_chain({"IMU_GYRO_CUTOFF": 0.0, "IMU_GYRO_DNF_EN": 1.0, "IMU_GYRO_DNF_HMC": 2.0}, 2000.0, motors)
    assert len(esc.steps) == 4
    assert gain(esc, 95.0) < 1e-6
    assert gain(esc, 180.0) < 1e-6
    with pytest.raises(DataError, match="IMU_GYRO_CUTOFF"):
        px4_chain({}, 2000.0)


HNTCH = {
    "INS_GYRO_FILTER": 0.0,
    "INS_HNTCH_ENABLE": 1.0,
    "INS_HNTCH_FREQ": 80.0,
    "INS_HNTCH_BW": 40.0,
    "INS_HNTCH_ATT": 40.0,
    "INS_HNTCH_HMNCS": 1.0,
    "INS_HNTCH_REF": 0.25,
    "INS_HNTCH_FM_RAT": 0.7,
}


def test_ardupilots_notch_follows_what_its_mode_says() -> None:
    by_throttle = HNTCH | {"INS_HNTCH_MODE": 1.0}
    for throttle, hz in (
        (0.25, 80.0),
        (0.36, 96.0),
        (0.04, 56.0),
    ):  # 80 sqrt(throttle / 0.25), 0.7 of it at least
        chain = ardupilot_chain(by_throttle, 2000.0, Sources(throttle=column(throttle)))
        assert gain(chain, hz) == pytest.approx(0.01, rel=1e-3)
    assert "follows the throttle" in ardupilot_chain(by_throttle, 2000.0).unknown[0]
    fixed = ardupilot_chain(HNTCH | {"INS_HNTCH_MODE": 0.0}, 2000.0)
    assert gain(fixed, 80.0) == pytest.approx(0.01, rel=1e-3)
    by_esc = HNTCH | {"INS_HNTCH_MODE": 3.0, "INS_HNTCH_REF": 1.0, "INS_HNTCH_OPTS": 2.0}
    each = ardupilot_chain(by_esc, 2000.0, Sources(motors_hz=[column(90.0), column(120.0)]))
    assert gain(each, 90.0) < 0.011
    assert gain(each, 120.0) < 0.011
    mean = ardupilot_chain(
        by_esc | {"INS_HNTCH_OPTS": 0.0}, 2000.0, Sources(motors_hz=[column(90.0), column(120.0)])
    )
    assert gain(mean, 105.0) == pytest.approx(0.01, rel=1e-3)
    assert "not known" in ardupilot_chain(HNTCH | {"INS_HNTCH_OPTS": 64.0}, 2000.0).unknown[0]


def test_two_notches_and_the_plain_one_of_older_versions() -> None:
    second = {"ENABLE": 1.0, "FREQ": 200.0, "BW": 50.0, "MODE": 0.0, "HMNCS": 1.0}
    both = HNTCH | {"INS_HNTCH_MODE": 0.0} | {f"INS_HNTC2_{name}": value for name, value in second.items()}
    two = ardupilot_chain(both, 2000.0)
    assert len(two.steps) == 2
    assert gain(two, 200.0) < 0.02
    plain = {"ENABLE": 1.0, "FREQ": 100.0, "BW": 30.0, "ATT": 20.0}
    stated = {"INS_GYRO_FILTER": 0.0} | {f"INS_NOTCH_{name}": value for name, value in plain.items()}
    old = ardupilot_chain(stated, 1000.0)
    assert gain(old, 100.0) == pytest.approx(0.1, rel=1e-3)
    with pytest.raises(DataError, match="INS_GYRO_FILTER"):
        ardupilot_chain({}, 1000.0)
