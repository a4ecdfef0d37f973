"""What happened: true sentences of real flights, and crashes whose cause was simulated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import flysid
from bench.faulty_dataflash import dataflash_bytes
from bench.faulty_quadrotor import Flight
from bench.faulty_ulog import ulog_bytes
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.lake.clocked import ClockedLog
from flysid.ingest.lake.crash import acceleration, find_crash
from flysid.ingest.lake.mishaps import mishaps
from flysid.ingest.lake.stretches import Stretches
from flysid.reviews.fact import Fact, Grade, Section, Table
from flysid.reviews.happened import review
from flysid.reviews.power import review as review_power
from tests.flysid.reviews.quadrotors import FlightsOf
from tests.flysid.reviews.shared_logs import dataflash_values, logged, needs_shared, open_logged, ulog_values

AGGRESSIVE = "ulog/quad_manual_aggressive_80s.ulg"
COPTER = "dataflash/copter_437s.bin"
WRITERS: dict[str, Callable[[Flight], bytes]] = {".bin": dataflash_bytes, ".ulg": ulog_bytes}


def fact_of(section: Section, key: str) -> Fact:
    return next(fact for fact in section.facts if fact.key == f"happened.{key}")


def reviewed(flight: Flight, suffix: str, folder: Path) -> Section:
    path = folder / f"flight{suffix}"
    path.write_bytes(WRITERS[suffix](flight))
    return review(open_logged(path))


# ------------------------------------------------------------------------------------- real flights


@needs_shared
def test_a_real_crash_and_its_cause() -> None:
    section = review(logged(AGGRESSIVE))
    time_s, _ = ulog_values(AGGRESSIVE, "sensor_combined", "accelerometer_m_s2[0]")
    axes = [ulog_values(AGGRESSIVE, "sensor_combined", f"accelerometer_m_s2[{i}]")[1] for i in range(3)]
    size = np.linalg.norm(axes, axis=0)
    felt = acceleration(logged(AGGRESSIVE))
    assert felt is not None
    boot_s = time_s[0] - felt.time_s[0]
    impact = fact_of(section, "impact")
    assert impact.value == pytest.approx(size.max(), rel=1e-5)
    assert impact.at_s == pytest.approx(time_s[np.argmax(size)] - boot_s, abs=0.01)
    (crash,) = (finding for finding in section.findings if finding.grade is Grade.BAD)
    assert crash.text == "Tipped over at 68 s, impact 392 m/s2 at 69.0 s: motors switched off in the air"
    assert "all motors were commanded to stop at 67.2 s" in crash.more
    assert "Landing detected" in crash.more


@needs_shared
def test_what_follows_a_crash_does_not_count() -> None:
    flight = logged(AGGRESSIVE)
    assert flight.ends_s == pytest.approx(67.8, abs=0.2)
    saturated = next(fact for fact in review_power(flight).facts if fact.key == "power.saturated")
    assert saturated.at_s is None or saturated.at_s < flight.ends_s


@needs_shared
def test_a_fit_leaves_out_what_the_review_calls_a_crash() -> None:
    """The log states no crash: only its sensors show it."""
    flight = logged(AGGRESSIVE)
    allowed = Stretches().allowed(flight.log)
    ((_, last_ns),) = allowed.spans[0]
    assert flight.clock.seconds(0, last_ns) == pytest.approx(flight.crashed_s, abs=1e-6)
    words = "left out from 1:08 to the end: crash: impact of 392 m/s2 (--keep-mishaps keeps it)"
    assert allowed.notes == (words,)
    assert Stretches().allowed(logged("ulog/quad_position_76s.ulg").log).notes == ()


@needs_shared
def test_a_failsafe_that_only_messages_state() -> None:
    """vehicle_status.failsafe stays 0 in this log."""
    section = review(logged("ulog/quad_stabilised_92s.ulg"))
    assert fact_of(section, "failsafes").value == "Low battery at 77.0 s"
    assert any(finding.text == "Failsafe at 77 s: Low battery" for finding in section.findings)


@needs_shared
def test_a_quiet_flight_has_no_crash() -> None:
    section = review(logged(COPTER))
    assert not section.findings
    assert fact_of(section, "modes").value == "RTL"
    rows = dataflash_values(COPTER, "ATT", "DesRoll", "Roll", "DesPitch", "Pitch")[:, 1:]
    apart = np.hypot(rows[:, 1] - rows[:, 0], rows[:, 3] - rows[:, 2]).max()
    found = str(fact_of(section, "departure").value)
    assert found == f"never; at most {apart:.0f} deg"


@needs_shared
def test_parameters_that_the_firmware_writes_are_no_changes() -> None:
    assert fact_of(review(logged(COPTER)), "parameter_changes").value == "none"
    assert fact_of(review(logged("ulog/quad_position_76s.ulg")), "parameter_changes").value == "none"


@needs_shared
@pytest.mark.parametrize("name", ["greenreaper_flight14.bfl", "hiro_lowP_lowD.bfl", "btfl_002.bbl"])
def test_a_racer_that_lands_has_not_crashed(name: str) -> None:
    flight = logged(f"blackbox/{name}")
    assert not np.isfinite(flight.ends_s)
    assert not [f for f in review(flight).findings if f.grade is Grade.BAD]


# ------------------------------------------------------------------------------------- simulated flights


@pytest.fixture(scope="module")
def flights(flights_of: FlightsOf) -> Mapping[str, Flight]:
    """One vehicle, sound, with a motor that stops, and with a supply that goes."""
    return flights_of("happened")


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_motor_that_stops(flights: Mapping[str, Flight], suffix: str, tmp_path: Path) -> None:
    section = reviewed(flights["motor"], suffix, tmp_path)
    (crash,) = (finding for finding in section.findings if finding.grade is Grade.BAD)
    assert crash.text.startswith("Tipped over at 3")
    assert crash.text.endswith(("motor 1 failed", "thrust of motor 1 lost"))
    assert "motor 1 was driven at full" in crash.more
    causes = next(s for s in section.shown if isinstance(s, Table) and s.title == "Likely causes")
    assert "motor 1" in causes.rows[0][1]
    departure = fact_of(section, "departure").value
    assert isinstance(departure, float)
    log = FlightLog(flysid.read(tmp_path / f"flight{suffix}"))
    sensed = find_crash(ClockedLog(log))
    assert sensed is not None
    boot, begin_ns = next((m.boot, m.span[0]) for m in mishaps(log) if m.ends)
    assert ClockedLog(log).clock.seconds(boot, begin_ns) <= sensed.begins_s + 1e-6
    assert 34.0 < departure < 35.5


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_supply_that_goes(flights: Mapping[str, Flight], suffix: str, tmp_path: Path) -> None:
    section = reviewed(flights["brown-out"], suffix, tmp_path)
    (cut,) = (finding for finding in section.findings if finding.grade is Grade.BAD)
    assert cut.text == "The log ends in the air at 41 s: brown-out"


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_hard_landing_is_no_crash(flights: Mapping[str, Flight], suffix: str, tmp_path: Path) -> None:
    section = reviewed(flights["dropped"], suffix, tmp_path)
    (blow,) = section.findings
    assert blow.text.startswith("Landed hard at 56 s: 1")
    assert blow.more == "sinking at 3.5 m/s"
    assert fact_of(section, "landing").value == pytest.approx(157.0, abs=20.0)


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize(("kind", "what"), [("fence", "fence breached"), ("battery", "battery")])
def test_a_failsafe_names_its_reason_and_its_mode(
    flights: Mapping[str, Flight], kind: str, what: str, suffix: str, tmp_path: Path
) -> None:
    """It is no bad end: the vehicle flies home."""
    section = reviewed(flights[kind], suffix, tmp_path)
    (failsafe,) = section.findings
    assert failsafe.grade is Grade.BAD
    assert failsafe.text.startswith("Failsafe at 30 s: ")
    assert what in failsafe.text
    assert failsafe.text.endswith("RTL")


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_log_that_is_cut_is_not_blamed(flights: Mapping[str, Flight], suffix: str, tmp_path: Path) -> None:
    whole = flights["sound"]
    n = len(whole.time_s) // 2
    cut = replace(whole, time_s=whole.time_s[:n], columns={k: v[:n] for k, v in whole.columns.items()})
    (finding,) = reviewed(cut, suffix, tmp_path).findings
    assert finding.grade is Grade.PLAIN
    assert "not determined" in finding.more


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_sound_flight(flights: Mapping[str, Flight], suffix: str, tmp_path: Path) -> None:
    section = reviewed(flights["sound"], suffix, tmp_path)
    assert not section.findings
    assert fact_of(section, "failsafes").value == "none"


def test_a_single_wrong_sample_is_no_crash(flights: Mapping[str, Flight], tmp_path: Path) -> None:
    """A blow without tipping over, after which it flies on."""
    path = tmp_path / "flight.ulg"
    sound = flights["sound"]
    columns = dict(sound.columns)
    columns["accel"] = columns["accel"].copy()
    columns["accel"][12_000] = 150.0
    path.write_bytes(ulog_bytes(replace(sound, columns=columns)))
    flight = open_logged(path)
    assert not np.isfinite(flight.ends_s)
    assert not review(flight).findings
