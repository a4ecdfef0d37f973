"""Margins and predictions of loops whose truth is known, and what must be refused."""

from __future__ import annotations

import gc
import json
import weakref
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner

from bench.gain_margins import Flown, Sampled
from flysid.cli.gains import command
from flysid.errors import DataError
from flysid.loops.betaflight import NO_CONDITIONS, betaflight
from flysid.loops.controller import refuse_misfit
from flysid.loops.judged import judge
from flysid.loops.margins import LEAST_MS, _figure, margins, trusted_band
from flysid.loops.prediction import predict
from flysid.loops.stick_response import Loop, plant
from tests.flysid.loops.autopilots import ardupilot_log, px4_log
from tests.flysid.loops.simulated import PID, Vehicle, fly, truth

LOGS = Path("../shared/logs/blackbox")
HEADER = {
    "Firmware revision": "Betaflight 3.4.0 (a5ba01666) OMNIBUSF4SD",
    "rollPID": "46,45,25",
    "pitchPID": "46,45,25",
    "yawPID": "65,45,20",
    "dterm_filter_type": "0",
    "dterm_lowpass_hz": "100",
    "dterm_lowpass2_hz": "200",
    "dterm_setpoint_weight": "60",
    "setpoint_relaxation_ratio": "0",
    "pidsum_limit": "500",
}


@dataclass
class Log:
    """As much of a stored log as the loops read."""

    name: str
    tables: dict[str, dict[str, Any]]

    @property
    def rows(self) -> dict[str, int]:
        return dict.fromkeys(self.tables, 1)

    def columns(self, stream: str) -> list[str]:
        return list(self.tables[stream])

    @property
    def facts(self) -> Any:
        return SimpleNamespace(streams=dict.fromkeys(self.tables, 1))

    def table(self, stream: str, columns: list[str]) -> pa.Table:
        return pa.table({name: self.tables[stream][name] for name in columns})


def log_of(seconds: float = 60.0, header: dict[str, str] | None = None, **flight: float) -> Log:
    """A simulated flight as a Betaflight log of its roll axis."""
    settings = HEADER | (header or {})
    own = betaflight(HEADER, "roll", NO_CONDITIONS)
    vehicle = Vehicle(delay_steps=6)
    record = fly(vehicle, own, seconds, 3, **flight)
    r, u, y = record.pieces[0]
    time = (np.arange(len(r)) * 2_000_000).astype(np.int64)
    nothing = np.zeros(len(r))
    main = {"time_ns": time, "gyroADC[0]": y, "axisP[0]": u, "axisI[0]": nothing, "axisD[0]": nothing}
    main |= {"loopIteration": np.arange(len(r)), "rcCommand[0]": nothing}
    main |= {f"{field}[{k}]": nothing for k in (1, 2) for field in ("gyroADC", "axisP", "axisI", "axisD")}
    return Log(
        "flight",
        {
            "main": main | {"rcCommand[3]": nothing + 1200.0},
            "setpoint": {"time_ns": time, "setpoint[0]": r},
            "parameters": {"name": list(settings), "text": list(settings.values())},
        },
    )


def test_margins_hold_the_truth_of_a_known_loop() -> None:
    vehicle = Vehicle()
    found = margins(Loop.of([fly(vehicle, PID, 150.0, 5)]), PID)
    for name, value in truth(vehicle, PID).items():
        figure = getattr(found, name)
        assert figure.value is None or figure.low <= value <= figure.high, name
    assert found.phase_deg.value == pytest.approx(truth(vehicle, PID)["phase_deg"], abs=3.0)
    assert found.crossover_hz.value == pytest.approx(truth(vehicle, PID)["crossover_hz"], rel=0.05)


def test_a_loop_goes_when_its_margins_are_known() -> None:
    """A review of a blackbox log of 10 MB held its two loops with what is resampled of them, 45 MB."""
    loop = Loop.of([fly(Vehicle(), PID, 60.0, 1)])
    kept = weakref.ref(loop)
    assert margins(loop, PID).phase_deg.value is not None
    del loop
    gc.collect()
    assert kept() is None


def test_disturbances_do_not_bend_the_plant() -> None:
    """What the controller does against them would give -1 / C."""
    vehicle = Vehicle()
    loop = Loop.of([fly(vehicle, PID, 200.0, 1, disturbance=150.0)])
    at = (loop.f >= 4.0) & (loop.f <= 12.0)
    share = plant(loop.mean)[at] / vehicle.response(loop.f[at])
    assert abs(np.mean(share) - 1.0) < 0.1


def test_of_a_gain_margin_beyond_the_sticks_only_the_lower_end_is_told() -> None:
    found = margins(Loop.of([fly(Vehicle(), PID, 60.0, 2)]), PID).gain_db
    assert found.value is None
    assert 0.0 < found.low <= truth(Vehicle(), PID)["gain_db"]
    assert found.said(".1f", " dB") == f"at least {found.low:.1f} dB"


def test_a_gain_margin_near_the_end_of_the_band_has_no_upper_end() -> None:
    """Of flights that reach -180 deg there at all, the margin came out low: 81 % held the truth."""
    vehicle = Vehicle(11.0, 0.04, 10)
    for seed in range(4):
        log = ardupilot_log(120.0, seed, vehicle=vehicle, noise=0.1)
        found = judge([log], ["roll"])[0].margins
        assert found is not None
        assert found.gain_db.value is None
        assert found.gain_db.low <= truth(Sampled(vehicle), Flown("ardupilot"))["gain_db"]


def test_in_still_air_a_band_that_reaches_far_bends_no_crossover() -> None:
    """One curve over seven octaves missed by 0.09 Hz what it claimed to know to 0.01 Hz."""
    vehicle = Vehicle()
    found = margins(Loop.of([fly(vehicle, PID, 90.0, 5, disturbance=0.0, noise=0.0)]), PID)
    assert found.band_hz[1] > 200.0
    for name in ("crossover_hz", "phase_deg", "ms"):
        figure = getattr(found, name)
        assert figure.low <= truth(vehicle, PID)[name] <= figure.high, name
    assert found.crossover_hz.value == pytest.approx(truth(vehicle, PID)["crossover_hz"], abs=0.05)
    assert found.gain_db.value == pytest.approx(truth(vehicle, PID)["gain_db"], abs=0.05)


def test_a_crossover_below_the_band_is_not_said_to_lie_above_it() -> None:
    """A soft loop crosses at 1.5 Hz, where the band begins; "above 14 Hz" was printed."""
    loop = Loop.of([fly(Vehicle(), PID, 60.0, 2)])
    soft = replace(PID, p=0.1 * PID.p, i=0.1 * PID.i, d=0.1 * PID.d)
    found = margins(loop, soft).crossover_hz
    assert found.value is None
    assert found.why.startswith("below 1.5 Hz")
    with pytest.raises(DataError, match="it is below 1 there") as refused:
        margins(loop, replace(PID, p=0.02 * PID.p, i=0.02 * PID.i, d=0.02 * PID.d))
    assert "slower stick movements" in refused.value.hint


@pytest.mark.parametrize("stick", [0.0, 0.5])
def test_without_sticks_nothing_is_known(stick: float) -> None:
    with pytest.raises(DataError, match=r"stick|known between|not one"):
        margins(Loop.of([fly(Vehicle(), PID, 60.0, 1, stick=stick)]), PID)


@pytest.mark.parametrize(("up_to", "refused"), [(4.0, True), (4.5, False)])
def test_a_band_has_more_lines_than_the_smooth_curve_has_coefficients(up_to: float, refused: bool) -> None:
    f = np.arange(0.0, 20.0, 0.5)
    loop: Any = SimpleNamespace(f=f, spread=lambda: np.where(f <= up_to, 0.1, 1.0))
    if refused:
        with pytest.raises(DataError, match=r"known between 2 and 4 Hz only"):
            trusted_band(loop)
    else:
        assert trusted_band(loop) == (1.5, 4.5)


def test_a_short_flight_is_refused() -> None:
    with pytest.raises(DataError, match="too short to identify a loop"):
        Loop.of([fly(Vehicle(), PID, 8.0, 1)])


@pytest.mark.parametrize("change", [{"p": 2.0}, {"p": 0.7}, {"d": 3.0}, {"p": 57.3, "i": 57.3, "d": 57.3}])
def test_gains_that_did_not_fly_are_refused(change: dict[str, float]) -> None:
    """Among them those in other units: radians for degrees."""
    loop = Loop.of([fly(Vehicle(), PID, 60.0, 1)])
    low, high = trusted_band(loop)
    assert refuse_misfit(PID, loop, low, high) < 0.1
    wrong = replace(PID, **{name: getattr(PID, name) * by for name, by in change.items()})
    with pytest.raises(DataError, match=r"do not give what the log recorded.*does not show why") as refused:
        refuse_misfit(wrong, loop, low, high)
    assert refused.value.hint.startswith("possible causes")  # none of them was shown


def test_a_prediction_for_other_gains_holds_on_another_vehicle_of_the_kind() -> None:
    rng = np.random.default_rng(0)

    def vehicle() -> Vehicle:
        return Vehicle(70.0 * np.exp(0.1 * rng.standard_normal()), 0.02, 8)

    early = [Loop.of([fly(vehicle(), PID, 60.0, seed)]) for seed in range(4)]
    later = replace(PID, p=1.6 * PID.p, d=1.3 * PID.d)
    told = predict(early, later)
    inside = []
    for _ in range(20):
        at = (told.f >= 2.0) & (told.f <= 20.0)
        f = told.f[at]
        g = vehicle().response(f)
        true = g * later.reference(f) / (1.0 + g * later.feedback(f))
        away = np.abs(true - told.response[at])
        inside.append(away <= told.radius()[at])
        assert np.median(away / np.abs(true)) < 0.25
    assert np.mean(inside) > 0.9


def test_two_flights_do_not_tell_how_flights_differ() -> None:
    loop = Loop.of([fly(Vehicle(), PID, 30.0, 1)])
    with pytest.raises(DataError, match="too few flights"):
        predict([loop, loop], PID)


def test_a_log_is_judged_from_its_header() -> None:
    found = judge([log_of()], ["roll"])[0]
    assert found.margins is not None
    assert found.gains == {"rollPID P": 46.0, "I": 45.0, "D": 25.0}
    own = truth(Vehicle(delay_steps=6), betaflight(HEADER, "roll", NO_CONDITIONS))
    assert found.margins.phase_deg.value == pytest.approx(own["phase_deg"], abs=5.0)
    assert len(found.lines()) == 5
    json.dumps(found.to_dict(), allow_nan=False)


@pytest.mark.skipif(not LOGS.is_dir(), reason="no real logs here")
def test_a_real_log_on_the_command_line(tmp_path: Path) -> None:
    picture = tmp_path / "nyquist.png"
    arguments = [str(LOGS / "greenreaper_flight26.bfl"), "--axis", "roll", "--json", "--plot", str(picture)]
    done = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert done.exception is None
    told = json.loads(done.stdout)[0]
    assert told["gains"] == {"rollPID P": 55.0, "I": 47.0, "D": 30.0}
    assert told["controller_miss"] < 0.1
    assert 12.0 < told["figures"]["crossover_hz"]["value"] < 20.0
    assert picture.stat().st_size > 1000


def test_the_window_does_not_turn_the_loop() -> None:
    """Averaged over frequency as the window does, the plant would show 0.9 deg more phase margin."""
    vehicle = Vehicle(12.0, 0.04, 8)
    found = [judge([px4_log(120.0, s, vehicle=vehicle, outer=6.5)], ["roll"])[0].margins for s in range(8)]
    phases = [m.phase_deg.value for m in found if m is not None and m.phase_deg.value is not None]
    assert len(phases) == 8
    true = truth(Sampled(vehicle), Flown("px4"))["phase_deg"]
    assert np.mean(phases) == pytest.approx(true, abs=0.45)


def test_no_sensitivity_is_told_to_peak_below_one() -> None:
    """|S| tends to 1 where the loop's gain fades; in a band below that it stayed at 0.6."""
    f = np.geomspace(2.0, 4.0, 60)
    vehicle = Vehicle()
    inside = np.abs(1.0 / (1.0 + vehicle.response(f) * PID.feedback(f)))
    assert inside.max() < LEAST_MS
    found = _figure(1.1, 0.3, LEAST_MS, "beyond the band")
    assert found.low == LEAST_MS
    assert found.high == pytest.approx(1.4)
    assert _figure(float(inside.max()), 0.1, LEAST_MS, "beyond the band").value == LEAST_MS
