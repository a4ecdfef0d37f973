"""Plans: what is refused and what to try, sweeps and doublets, autopilots' parameters, the table."""

from __future__ import annotations

import re

import numpy as np
import pytest

from flysid.dataset import Dataset, Segment, Signal
from flysid.errors import UsageError
from flysid.ingest.align.recipe import parse_recipe
from flysid.plan.autopilots import ardupilot, px4_plane
from flysid.plan.briefing import axes_of_last_flight, briefing, recipe_for
from flysid.plan.flightplan import CommandedAxis, Kind, axis_of, lowest_hz, make_plan, within

ROLL = CommandedAxis("roll", 0.1)
PITCH = CommandedAxis("pitch", 0.1)


def refused(
    match: str,
    axes: tuple[CommandedAxis, ...] = (ROLL,),
    band: tuple[float, float] = (0.5, 5.0),
    seconds: float = 30.0,
    rate: float = 50.0,
    kind: Kind = "multisine",
) -> str:
    with pytest.raises(UsageError, match=match) as caught:
        make_plan(kind, axes, band, seconds, rate)
    return caught.value.hint or ""


def test_what_makes_no_sense_is_refused() -> None:
    refused("no axis", axes=())
    refused("named twice", axes=(ROLL, ROLL))
    refused("no band", band=(5.0, 0.5))
    refused("no band", band=(0.0, 5.0))
    refused("no band", band=(float("nan"), 5.0))
    refused("is not a flight", seconds=-1.0)
    refused("too many rows", seconds=1e9)
    assert "--rate 150" in refused("show less than 25 Hz", band=(0.5, 30.0))


def test_a_flight_too_short_names_one_that_is_long_enough() -> None:
    for axes, band in (((ROLL, PITCH), (0.5, 1.0)), ((ROLL,), (0.05, 4.0))):
        hint = refused("too short", axes=axes, band=band, seconds=8.0)
        found = re.search(r"--seconds (\d+)", hint)
        assert found is not None
        plan = make_plan("multisine", axes, band, float(found[1]), 50.0)
        assert min(map(len, plan.lines)) >= 5
    hint = refused("too short for a sweep", band=(0.1, 4.0), seconds=20.0, kind="chirp")
    assert "--seconds 41" in hint
    refused("room for", band=(0.01, 0.1), seconds=20.0, kind="doublets")


@pytest.mark.parametrize("kind", ["multisine", "chirp", "doublets"])
def test_what_is_proposed_can_be_flown(kind: Kind) -> None:
    """A sweep from 0.2 mHz was to take 20299.9 s, 5.6 hours, and so long a plan was refused once more."""
    rng = np.random.default_rng(41)
    proposed = 0
    for _ in range(12):
        axes = (ROLL, PITCH)[: int(rng.integers(1, 3))]
        low = float(np.exp(rng.uniform(np.log(1e-4), np.log(0.5))))
        band = low, low * float(rng.uniform(1.1, 20.0))
        seconds = float(rng.uniform(10.0, 120.0))
        try:
            make_plan(kind, axes, band, seconds, 50.0)
            continue
        except UsageError as error:
            hint = error.hint or ""
        proposed += 1
        longer = re.search(r"--seconds (\d+)", hint)
        instead = re.search(r"--band (\S+) ([^ :]+)", hint)
        if longer:
            make_plan(kind, axes, band, float(longer[1]), 50.0)
        else:
            assert instead, hint
            make_plan(kind, axes, (float(instead[1]), float(instead[2])), seconds, 50.0)
    assert proposed > 3


def test_no_flight_of_days_is_proposed() -> None:
    """479054 s were, 5.5 days, for a band that a spurious slow pole began."""
    hint = refused("too short", axes=(ROLL, PITCH), band=(4.2e-6, 1.0), seconds=60.0)
    assert "--seconds" not in hint
    found = re.search(r"--band ([\d.]+) ([\d.]+): what 60 s can show", hint)
    assert found is not None
    plan = make_plan("multisine", (ROLL, PITCH), (float(found[1]), float(found[2])), 60.0, 50.0)
    assert min(map(len, plan.lines)) >= 5
    for kind in ("multisine", "chirp"):
        assert make_plan(kind, (ROLL, PITCH), (lowest_hz(kind, 2, 60.0), 1.0), 60.0, 50.0).seconds <= 61.0


@pytest.mark.parametrize(
    "text", ["roll", "roll=", "roll=x", "=3", "roll=-1", "roll=0", "roll=1e999", "roll=1.2.3"]
)
def test_an_axis_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        axis_of(text)


def test_axes_are_read_with_their_units_and_kept_within_limits() -> None:
    assert axis_of("theta_in=5deg") == CommandedAxis("theta_in", 5.0, "deg")
    assert axis_of("RATE.ROut=0.15") == CommandedAxis("RATE.ROut", 0.15)
    assert axis_of("p=20 deg/s") == CommandedAxis("p", 20.0, "deg/s")
    assert within((ROLL, PITCH), (CommandedAxis("roll", 0.02), CommandedAxis("pitch", 3.0))) == (
        CommandedAxis("roll", 0.02),
        PITCH,
    )
    with pytest.raises(UsageError, match="does not command"):
        within((ROLL,), (CommandedAxis("yaw", 1.0),))
    with pytest.raises(UsageError, match="in 'rad'"):
        within((CommandedAxis("a", 1.0, "deg"),), (CommandedAxis("a", 1.0, "rad"),))


def test_chirps_and_doublets_take_the_axes_in_turn() -> None:
    for kind in ("chirp", "doublets"):
        plan = make_plan(kind, (ROLL, PITCH), (0.2, 4.0), 60.0, 40.0)
        assert plan.correlation == 0.0
        assert not plan.u[1200:, 0].any()
        assert not plan.u[:1200, 1].any()
        assert np.abs(plan.u).max(axis=0) == pytest.approx([0.1, 0.1], rel=0.02)
        assert abs(plan.u[0, 0]) < 1e-9
    sweep = make_plan("chirp", (ROLL,), (0.2, 4.0), 60.0, 40.0).u[:, 0]
    power = np.abs(np.fft.rfft(sweep)) ** 2
    inside = slice(round(0.15 * 60), 5 * 60)
    assert power[inside].sum() > 0.98 * power.sum()


def test_ardupilots_parameters() -> None:
    plan = make_plan("chirp", (ROLL, PITCH), (0.5, 20.0), 120.0, 100.0)
    files = ardupilot(plan, "mixer")
    assert [f.name for f in files] == ["ardupilot-roll.param", "ardupilot-pitch.param"]
    values = dict(line.split(",") for line in files[1].text.splitlines())
    assert values == {
        "SID_AXIS": "11",
        "SID_MAGNITUDE": "0.1",
        "SID_F_START_HZ": "0.5",
        "SID_F_STOP_HZ": "20",
        "SID_T_FADE_IN": "2",
        "SID_T_REC": "60",
        "SID_T_FADE_OUT": "2",
    }
    assert float(values["SID_T_REC"]) > 2.0 / float(values["SID_F_START_HZ"])  # else ArduPilot stops at once
    rate = make_plan("chirp", (CommandedAxis("yaw", 20.0, "deg/s"),), (0.5, 20.0), 60.0, 100.0)
    assert "SID_AXIS,9\n" in ardupilot(rate, "rate")[0].text


def test_what_an_autopilot_cannot_fly_is_refused() -> None:
    def sweep(axis: CommandedAxis, band: tuple[float, float] = (0.5, 20.0), seconds: float = 60.0):  # type: ignore[no-untyped-def]
        return make_plan("chirp", (axis,), band, seconds, 500.0)

    with pytest.raises(UsageError, match="cannot fly multisine"):
        ardupilot(make_plan("multisine", (ROLL,), (0.5, 5.0), 30.0, 50.0), "mixer")
    for place, axis, match in (
        ("mixer", CommandedAxis("wing", 0.1), "no axis 'wing'"),
        ("rate", CommandedAxis("roll", 5.0, "deg"), "counts in deg/s"),
        ("mixer", CommandedAxis("roll", 5.0), "the whole of a mixer axis is 1"),
    ):
        with pytest.raises(UsageError, match=match):
            ardupilot(sweep(axis), place)
    with pytest.raises(UsageError, match="at most 255 s"):
        ardupilot(sweep(ROLL, seconds=300.0), "mixer")
    with pytest.raises(UsageError, match="to 30 Hz"):
        px4_plane(sweep(ROLL, (0.5, 50.0)))
    with pytest.raises(UsageError, match="no axis throttle"):
        px4_plane(sweep(CommandedAxis("throttle", 0.1)))


def test_px4s_parameters() -> None:
    plan = make_plan("chirp", (ROLL, PITCH), (0.5, 10.0), 60.0, 100.0)
    rows = {row.split("\t")[2]: row.split("\t")[3:] for row in px4_plane(plan).text.splitlines()}
    assert rows["FW_AT_AXES"] == ["3", "6"]
    assert rows["FW_AT_SYSID_TYPE"] == ["2", "6"]
    assert rows["FW_AT_APPLY"] == ["0", "6"]
    assert rows["FW_AT_SYSID_TIME"] == ["30", "9"]
    assert "FW_AT_SYSID_AMP" not in rows


def test_amplitudes_go_as_far_as_the_last_flight() -> None:
    rng = np.random.default_rng(0)
    first = 50.0 * rng.standard_normal((400, 1))
    last = 7.0 + 2.0 * np.sin(np.arange(4000) / 9.0)[:, None]
    y = [np.zeros((400, 1)), np.zeros((4000, 1))]
    y = [v + rng.standard_normal(v.shape) for v in y]
    parts = [Segment(u, v, flight=name) for name, u, v in zip("ab", (first, last), y, strict=True)]
    data = Dataset(0.1, (Signal("u", "deg"),), (Signal("y"),), tuple(parts))
    (axis,) = axes_of_last_flight(data)
    assert (axis.name, axis.unit) == ("u", "deg")
    assert axis.peak == pytest.approx(2.0, rel=0.02)


def test_the_recipe_of_a_plan_is_one() -> None:
    import tomllib

    plan = make_plan("multisine", (CommandedAxis("RATE.ROut", 0.1), PITCH), (0.5, 5.0), 30.0, 50.0)
    recipe = parse_recipe(tomllib.loads(recipe_for(plan, ["RATE.R", "gy"])))
    assert recipe.channels["gy"].inputs == ("RATE_ROut", "pitch")
    assert recipe.signals["RATE_R"].sources[0].stream == "RATE"
    assert recipe.signals["gy"].sources[0].stream == "table"
    with pytest.raises(UsageError, match="is an axis"):
        recipe_for(plan, ["pitch"])


def test_the_briefing_says_what_to_mind() -> None:
    words = " ".join(briefing(make_plan("multisine", (ROLL, PITCH), (0.5, 5.0), 30.0, 50.0)))
    for said in ("All axes at once", "simulator", "Begin with a third", "take over", "50 Hz"):
        assert said in words
