import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from flysid.cli import root
from flysid.cli.pooled_suggestions import pool, pooled_advice
from flysid.cli.suggestions import advice, next_command, short_names
from flysid.dataset import Dataset
from flysid.flight import ClockMap, Damage, Flight, Source
from flysid.ingest.align.recipe import load_recipe, parse_recipe, shipped_recipes
from flysid.ingest.align.signals import FlightLog
from flysid.ingest.excitation.delay import Delay, estimate_delay
from flysid.ingest.excitation.enough import least_hz
from flysid.ingest.lake.suggest import Suggestion, suggest
from flysid.ingest.lake.survey import StreamCount, Survey, verdict
from flysid.progress import listening
from tests.ingest.align.test_align import T50, table
from tests.ingest.lake.test_lake import folder  # noqa: F401

RECIPE_DOCUMENT: dict[str, Any] = {
    "name": "r",
    "signals": {
        "u": {"unit": "deg", "hold": "zero", "sources": [{"stream": "CMD", "field": "u", "unit": "deg"}]},
        "y": {"unit": "m/s", "sources": [{"stream": "STATE", "field": "y", "unit": "m/s"}]},
    },
    "channels": {"c": {"inputs": ["u"], "outputs": ["y"], "min_rate_hz": 20.0, "remedy": "log faster"}},
}
RECIPE = parse_recipe(RECIPE_DOCUMENT)
ATTITUDE = RECIPE_DOCUMENT["channels"]["c"] | {"min_rate_hz": least_hz("attitude", "tlog")}
T = np.arange(3000, dtype=np.int64) * 20_000_000
RNG = np.random.default_rng(5)
U = np.repeat(RNG.normal(size=120), 25)


def one(u: np.ndarray, y: np.ndarray, t: np.ndarray = T) -> Suggestion:
    log = Flight(Source("f", "tlog", 1, "0" * 64), {"CMD": table(t, u=u), "STATE": table(t, y=y)})
    (found,) = suggest([FlightLog(log)], [RECIPE])
    return found


def lag(u: np.ndarray, samples: int, pole: float = 0.9) -> np.ndarray:
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = pole * y[k - 1] + (1 - pole) * (u[k - samples] if k >= samples else 0.0)
    return y


def test_a_well_excited_channel_is_good_with_its_delay_and_sign() -> None:
    found = one(U, -2.0 * lag(U, 5) + 0.02 * RNG.normal(size=len(U)))
    assert (found.verdict, found.advice) == ("good", "")
    assert found.sign == -1
    assert found.delay_s == pytest.approx(0.08, abs=0.02)
    assert found.rate_hz == pytest.approx(50.0)
    assert found.band_hz is not None
    assert found.coherence > 0.8


def test_what_stands_in_the_way_is_named() -> None:
    y = lag(U, 1)
    assert one(1e-6 * U, y).verdict == "too quiet"
    assert one(np.zeros(len(U)), y).verdict == "too quiet"
    assert one(U[:200], y[:200], T[:200]).verdict == "too short"
    slow = one(U[::5], y[::5], T[::5])
    assert slow.verdict == "too slow"
    assert "log faster" in slow.advice
    assert one(U, RNG.normal(size=len(U))).verdict == "weak"


def test_an_oscillation_is_no_band() -> None:
    """One frequency at which both move says nothing of a response."""
    t_s = T * 1e-9
    u = np.sin(2 * np.pi * 3.0 * t_s)
    y = np.sin(2 * np.pi * 3.0 * t_s - 1.0)
    noise = RNG.normal(scale=0.3, size=(2, len(T)))
    found = one(u + noise[0], y + noise[1])
    assert found.band_hz is not None
    assert found.band_hz[1] < 2 * found.band_hz[0]
    assert found.verdict == "weak"


def test_what_a_condition_leaves_out_is_said() -> None:
    armed = [{"name": "armed", "sources": [{"stream": "BEAT", "field": "mode"}], "has_bits": 128}]
    beat = table(T[::50], mode=np.full(len(T[::50]), 81))
    log = Flight(
        Source("f", "tlog", 1, "0" * 64), {"CMD": table(T, u=U), "STATE": table(T, y=lag(U, 1)), "BEAT": beat}
    )
    recipe = parse_recipe({**RECIPE_DOCUMENT, "conditions": armed})
    (found,) = suggest([FlightLog(log)], [recipe])
    assert found.verdict == "excluded"
    assert found.advice == "condition 'armed' never holds (bits 128): BEAT.mode is 81 in this log"


def test_flights_lose_their_hash_where_no_two_share_a_name() -> None:
    names = short_names(["a-1-0f", "b-2-0f", "b-2-1f", "c"])
    assert names == {"a-1-0f": "a-1", "b-2-0f": "b-2-0f", "b-2-1f": "b-2-1f", "c": "c"}


def test_advice_is_said_once_with_its_flights_and_channels() -> None:
    def of(flight: str, channel: str) -> Suggestion:
        return Suggestion(flight, "r", channel, "u", "y", verdict="weak", advice="fly more")

    both = [of("a", "roll"), of("a", "pitch"), of("b", "roll")]
    assert advice(both, {"a": "a", "b": "b"}) == ["a (roll, pitch), b (roll): fly more"]
    assert advice(both[:2], {"a": "a"}) == ["roll, pitch: fly more"]


def test_a_pair_inside_a_loop_is_no_good_one() -> None:
    """What a controller gives answers what it drives; the recipe knows the setpoint that excites the loop."""
    goal = np.repeat(RNG.normal(size=120), 25)
    u = goal + 0.3 * RNG.normal(size=len(goal))
    streams = {"CMD": table(T, u=u), "STATE": table(T, y=lag(u, 2)), "GOAL": table(T, r=goal)}
    log = FlightLog(Flight(Source("f", "tlog", 1, "0" * 64), streams))
    signals = RECIPE_DOCUMENT["signals"] | {
        "r": {"unit": "deg", "hold": "zero", "sources": [{"stream": "GOAL", "field": "r", "unit": "deg"}]}
    }
    inside = RECIPE_DOCUMENT["channels"]["c"] | {"reference": ["r"]}
    around = RECIPE_DOCUMENT["channels"]["c"] | {"inputs": ["r"], "reference": ["r"]}
    recipe = parse_recipe(RECIPE_DOCUMENT | {"signals": signals, "channels": {"pid": inside, "loop": around}})
    pid, loop = suggest([log], [recipe])
    assert (pid.verdict, loop.verdict) == ("closed loop", "good")
    assert "'flysid tf' measures through what drives it: --reference r" in pid.advice


def test_a_flight_without_the_streams_has_no_suggestion() -> None:
    log = Flight(Source("f", "tlog", 1, "0" * 64), {"CMD": table(T50, u=np.zeros(500))})
    assert suggest([FlightLog(log)], [RECIPE]) == []


def test_ls_suggest_prints_a_table_and_advice(folder: Path) -> None:  # noqa: F811
    result = CliRunner().invoke(root, ["ls", str(folder), "--suggest"], catch_exceptions=False)
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert max(map(len, lines)) <= 100
    assert "too quiet" in result.stdout
    assert "doublets" in result.stdout
    assert "next: " in result.stderr
    every = CliRunner().invoke(root, ["ls", str(folder), "--suggest", "--all"], catch_exceptions=False)
    assert "TOO QUIET  " in every.stdout
    folded = " ".join(every.stdout.split())
    assert folded.count("nothing moves: ") == 1  # once, not above and below
    assert "  in all" not in every.stdout
    assert "in all 1 segments" not in folded
    document = json.loads(CliRunner().invoke(root, ["ls", str(folder), "--suggest", "--json"]).stdout)
    assert {s["channel"] for s in document["suggestions"]} == {"roll", "pitch"}
    assert {s["verdict"] for s in document["suggestions"]} <= {"good", "weak", "too slow", "too quiet"}


@pytest.mark.parametrize(("seconds", "rate_hz"), [(5, 50), (50, 50), (60, 50), (60, 5)])
def test_doctor_and_suggestions_go_by_one_rule(seconds: int, rate_hz: int) -> None:
    """And foresee that 50 s are too few for a verdict."""
    every = 50 // rate_hz
    rows = slice(0, 50 * seconds, every)
    recipe = parse_recipe(RECIPE_DOCUMENT | {"channels": {"c": ATTITUDE}})
    log = Flight(
        Source("f", "tlog", 1, "0" * 64),
        {"CMD": table(T[rows], u=U[rows]), "STATE": table(T[rows], y=lag(U, 5)[rows])},
    )
    (found,) = suggest([FlightLog(log)], [recipe])
    last_ns = int(seconds * 1e9) - 20_000_000  # of 50 a second
    count = StreamCount(seconds * rate_hz, {0: (seconds * rate_hz, 0, last_ns)}, {})
    count.angles["r"] = (100, 0.0, 100.0)
    clock = ClockMap(0, 0, last_ns)
    looked = Survey(log.source, {"ATTITUDE": count}, Damage(), (clock,), {})
    words, advice = verdict(looked)
    assert words.startswith({5: "too short", 50: "ok", 60: "ok" if rate_hz == 50 else "too slow"}[seconds])
    assert found.verdict == {"ok": "good"}.get(words, words.partition(":")[0])
    if seconds == 60 and rate_hz == 50:
        assert not advice
    if seconds == 50:
        assert advice == found.advice
        assert "50 s alone will hardly give a verdict" in advice


def test_the_rule_is_what_shipped_recipes_ask_for() -> None:
    asked: dict[tuple[str, bool], float] = {}
    for name in shipped_recipes():
        kind = {"attitude": "attitude", "velocity": "velocity", "rate": "rates", "rates": "rates"}.get(
            name.rpartition("-")[2]
        )
        if kind is not None:
            key = kind, name.startswith("betaflight")
            lowest = min(c.min_rate_hz for c in load_recipe(name).channels.values())
            asked[key] = min(asked.get(key, lowest), lowest)
    assert asked == {(kind, box): least_hz(kind, "blackbox" if box else "tlog") for kind, box in asked}
    assert {kind for kind, _ in asked} == {"attitude", "velocity", "rates"}


def test_the_command_to_run_next_is_of_one_vehicle() -> None:
    """A fit refuses flights of several; the one with most that is good is named."""
    good = Suggestion("a", "r", "roll", "u", "y", "good")
    found = [good, replace(good, flight="b"), replace(good, flight="b", channel="pitch")]
    assert next_command(found, "logs", {"a": "17", "b": "2f"}) == (
        "next: flysid fit logs --recipe r --vehicle 2f -o run"
    )
    assert next_command(found, "logs", {}) == "next: flysid fit logs --recipe r -o run"


def test_a_table_s_fields_are_to_be_named() -> None:
    assert next_command([], "rig.csv", {}).startswith("next: 'flysid show rig.csv --fields' lists the fields")


def found_in(flight: str, share: int) -> Suggestion:
    words = f"at most {share} % of the output's power follows motor1; fly steps"
    return Suggestion(
        flight,
        "r",
        "roll",
        "motor1",
        "y",
        "weak",
        words,
        rate_hz=250.0,
        duration_s=60.0,
        coherence=share / 100.0,
        band_hz=(0.5, 120.0),
        delay_s=0.02,
        delay_low_s=0.01,
        delay_high_s=0.01 * share / 9.0,
        sign=1,
    )


def test_several_flights_are_a_row_a_channel() -> None:
    """Ten real flights of nine channels were 270 lines."""
    found = [found_in("a", 9), found_in("b", 23), found_in("c", 14)]
    found[2] = replace(
        found[2], channel="pitch", input="motor2", advice=found[2].advice.replace("motor1", "motor2")
    )
    assert pool(found) == [
        ("roll", "+motor1", "2", "120 s", "250 Hz", "0.09 to 0.23", "0.5 to 120", "20 (10-26)"),
        ("pitch", "+motor2", "1", "60 s", "250 Hz", "0.14", "0.5 to 120", "20 (10-16)"),
    ]
    assert pooled_advice(found, {f: f for f in "abc"}) == [
        "roll (2 flights), pitch (c): at most 9 to 23 % of the output's power follows the input; fly steps"
    ]


def test_progress_counts_channels_within_a_flight() -> None:
    """Ten real flights stood at 50 % for a minute."""
    streams = {"CMD": table(T, u=U), "STATE": table(T, y=lag(U, 5))}
    logs = [FlightLog(Flight(Source(name, "tlog", 1, "0" * 64), streams)) for name in "ab"]
    channels = {"c": RECIPE_DOCUMENT["channels"]["c"], "d": RECIPE_DOCUMENT["channels"]["c"]}
    shares: list[float | None] = []
    with listening(lambda step: shares.append(step.share)):
        suggest(logs, [parse_recipe(RECIPE_DOCUMENT | {"channels": channels})])
    assert shares == [0.0, 0.25, 0.5, 0.75]


def test_a_flight_is_read_once_and_dead_times_are_sought_of_what_is_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two channels of the same two inputs: twice the columns would be read, and four dead times sought."""
    y = lag(U, 5) + 0.02 * RNG.normal(size=len(U))
    tables = {"CMD": table(T, u=U, v=np.roll(U, 700)), "STATE": table(T, y=y, z=-y)}
    flight = Flight(Source("f", "tlog", 1, "0" * 64), tables)
    document = RECIPE_DOCUMENT["signals"]
    signals = {
        name: document[like] | {"sources": [document[like]["sources"][0] | {"field": name}]}
        for name, like in (("u", "u"), ("v", "u"), ("y", "y"), ("z", "y"))
    }
    channels = {out: {"inputs": ["u", "v"], "outputs": [out]} for out in ("y", "z")}
    recipe = parse_recipe({"name": "r", "signals": signals, "channels": channels})
    read: Counter[str] = Counter()
    sought: list[int] = []

    class Counting(FlightLog):
        def table(self, stream: str, columns: Sequence[str]) -> Any:
            read[f"{stream} {columns[-1]}"] += 1
            return super().table(stream, columns)

    def seek(data: Dataset, column: int, output: int) -> Delay:
        sought.append(column)
        return estimate_delay(data, column, output)

    monkeypatch.setattr("flysid.ingest.lake.suggest.estimate_delay", seek)
    found = suggest([Counting(flight)], [recipe])
    assert [(s.channel, s.input, s.verdict) for s in found] == [("y", "u", "good"), ("z", "u", "good")]
    assert read == {"CMD u": 1, "CMD v": 1, "STATE y": 1, "STATE z": 1}
    assert sought == [0, 0]
