"""Flights that nobody here made: every shipped recipe that fits them runs, and says what it should."""

from pathlib import Path

import pytest

import flysid
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.lake.suggest import Suggestion, suggest

LOGS = Path(__file__).parents[2] / ".." / "shared" / "logs"
pytestmark = pytest.mark.skipif(not LOGS.is_dir(), reason="needs ../shared/logs")


def suggestions(path: str, *recipes: str) -> dict[str, Suggestion]:
    log = FlightLog(flysid.read(LOGS / path))
    return {f"{s.recipe} {s.channel}": s for s in suggest([log], recipes)}


def test_a_real_arducopter_identifies_attitude_and_is_too_slow_for_rates() -> None:
    found = suggestions(
        "dataflash/copter_437s.bin", "ardupilot-attitude", "ardupilot-rate", "ardupilot-velocity"
    )
    for channel in ("roll", "pitch"):
        attitude = found[f"ardupilot-attitude {channel}"]
        assert attitude.verdict == "good"
        assert attitude.sign == 1
        assert attitude.rate_hz == pytest.approx(9.9, abs=0.1)
        rate = found[f"ardupilot-rate {channel}_rate"]
        assert rate.verdict == "too slow"
        assert "25 Hz" in rate.advice
    assert found["ardupilot-velocity v_z"].verdict == "good"


@pytest.mark.parametrize(
    ("name", "good"),
    [
        ("quad_position_76s", {"px4-velocity v_x": -1, "px4-velocity v_y": 1}),
        ("quad_stabilised_92s", {}),
        ("quad_manual_aggressive_80s", {}),
    ],
)
def test_real_px4_quadrotors_identify_attitude_and_rates(name: str, good: dict[str, int]) -> None:
    found = suggestions(f"ulog/{name}.ulg", "px4-attitude", "px4-rates", "px4-velocity")
    for channel in ("px4-attitude roll", "px4-attitude pitch", "px4-rates roll_rate", "px4-rates pitch_rate"):
        assert found[channel].verdict == "good"
        assert found[channel].sign == 1
        assert found[channel].band_hz is not None
    for channel, sign in good.items():
        assert found[channel].verdict == "good"
        assert found[channel].sign == sign  # nose up brakes, right side down drives right


def test_a_simulated_hover_is_too_quiet() -> None:
    found = suggestions("tlog/sitl_copter_500s.tlog", "ardupilot-attitude")
    assert {s.verdict for s in found.values()} == {"too quiet"}
