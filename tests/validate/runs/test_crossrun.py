"""Two runs against each other: only on what neither has trained on, and refused where that is not known."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import Dataset, Signal
from flysid.errors import DataError, UsageError
from flysid.files import write_atomically
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.chosen_flights import Selection
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.synth.synth import WRITERS, Order, flights
from flysid.split import plan_split
from flysid.validate.runs import crossrun
from flysid.validate.runs.crossrun import RunSource, expected_of_runs, judge_runs, unseen
from flysid.validate.runs.fitting import fit_run
from flysid.validate.runs.judge import judge_run
from flysid.validate.runs.run import ChannelRun, FitSettings, HeldOut, Run, held_out
from flysid.validate.show.page.narrative import name_model
from tests.contest import linear_side
from tests.fakes import fields_of

CHANNEL = "longitudinal"


def flown(names: str, seed: int = 0) -> Dataset:
    """One segment of 200 samples per letter: the same letter is the same flight."""
    made = [np.random.default_rng([seed, ord(n)]).normal(size=(200, 2)) for n in names]
    data = Dataset.from_arrays([m[:, :1] for m in made], [m[:, 1:] for m in made], 0.05)
    return data.with_segments([replace(s, flight=n) for s, n in zip(data.segments, names, strict=True)])


def held(train: Dataset, test: Dataset) -> HeldOut:
    """As of two runs on different data: the hash tells them apart."""
    split = {"by": "flight", "seed": 0, "holdout": 0.3, "guard_s": 0, "train": [], "test": []}
    channel = ChannelRun("c", {}, split | {"data_sha256": train.content_hash()})
    return HeldOut(channel, {}, train, test, seen=train.flights)


def test_flights_that_the_other_run_trained_on_are_left_out() -> None:
    left = unseen(held(flown("abc"), flown("z")), held(flown("xy"), flown("bde")))
    assert left.flights == ("d", "e")
    with pytest.raises(DataError, match="every held-out flight"):
        unseen(held(flown("abc"), flown("z")), held(flown("xy"), flown("ab")))


def test_a_copy_of_a_training_flight_under_another_name_is_refused() -> None:
    copy = flown("b")
    copy = copy.with_segments([replace(copy.segments[0], flight="renamed")])
    with pytest.raises(DataError, match="'renamed' repeats training flight 'b'"):
        unseen(held(flown("abc"), flown("z")), held(flown("xy"), copy))


def test_blocks_of_one_flight_serve_only_where_both_runs_held_out_the_same() -> None:
    data = flown("a")
    one, other = (plan_split(data, by="time", guard_s=0.0, seed=seed) for seed in (1, 2))
    sides = [HeldOut(ChannelRun("c", {}, s.to_dict()), {}, *s.apply(data), ("a",)) for s in (one, one, other)]
    assert unseen(sides[0], sides[1]) == sides[1].test
    with pytest.raises(DataError, match="every held-out flight"):
        unseen(sides[0], sides[2])


def test_other_units_or_rates_are_not_compared() -> None:
    a = held(flown("a"), flown("z"))
    b = held(flown("x"), flown("d"))
    with pytest.raises(DataError, match="different outputs"):
        unseen(a, replace(b, test=replace(b.test, outputs=(Signal(b.test.outputs[0].name, "km/h"),))))
    with pytest.raises(DataError, match="different sample times"):
        unseen(a, replace(b, test=replace(b.test, dt_s=0.1)))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Run]:
    """Two runs on the same six flights that hold out different ones."""
    root = tmp_path_factory.mktemp("flights")
    for recording in flights(Order(duration_s=20.0)):
        write_atomically(root / f"{recording.name}{WRITERS['mcap'][0]}", WRITERS["mcap"][1](recording))
    list(ingest_logs(find_logs([root]), root / "data"))
    lake = open_lake(root / "data")
    chosen = FitSettings(channels=(CHANNEL,), rules=1, effort="quick", rotate=False)
    with linear_side("arx", "oe"):
        a = fit_run(lake, "ardrone-synthetic", root / "r7", replace(chosen, seed=7))
        b = fit_run(lake, "ardrone-synthetic", root / "r13", replace(chosen, seed=13))
    return a, b


def test_two_runs_are_compared_like_with_like(runs: tuple[Run, Run]) -> None:
    a = RunSource(runs[0])
    judgement = judge_runs(a, a)
    c = judgement.comparisons[CHANNEL]
    assert (c.baseline, c.contender) == ("a:ts", "b:ts")
    assert c.verdict[c.test.outputs[0].name].verdict == "same"
    both = {f"{r}:{m}" for r in "ab" for m in ("line", "arx", "oe", "polynarx", "static_ts", "ts")}
    assert set(c.models) >= {"mean", "persistence"} | both
    assert judge_runs(a, a, label="arx").comparisons[CHANNEL].contender == "b:arx"
    with pytest.raises(UsageError, match="model 'bj'"):
        judge_runs(a, a, label="bj")
    assert name_model("b:ts") == "fuzzy model of run B"
    expected = expected_of_runs(a.run, a.run)
    assert fields_of(expected["channels"]) == fields_of(judgement.document["channels"])
    with pytest.raises(UsageError, match="model 'bj'"):
        expected_of_runs(a.run, a.run, "bj")


def test_the_rules_of_one_run_are_compared_with_the_baseline_of_one_that_has_none(
    runs: tuple[Run, Run], tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(runs[0].folder, tmp_path / "linear"))
    (channel,) = runs[0].channels
    models = {name: file for name, file in channel.models.items() if name != "ts"}
    linear = RunSource(replace(runs[0], folder=folder, channels=(replace(channel, models=models),)))
    for a, b, heads in (
        (linear, RunSource(runs[0]), (f"a:{channel.baseline}", "b:ts")),
        (RunSource(runs[0]), linear, ("a:ts", f"b:{channel.baseline}")),
    ):
        c = judge_runs(a, b).comparisons[CHANNEL]
        assert (c.baseline, c.contender) == heads


def test_runs_without_rules_meet_in_the_baseline_that_validate_names(runs: tuple[Run, Run]) -> None:
    (channel,) = runs[0].channels
    linear = {label: file for label, file in channel.models.items() if label != "ts"}
    for chosen in ("oe", "arx"):
        a = replace(runs[0], channels=(replace(channel, models=linear, baseline=chosen),))
        assert judge_run(a).comparisons[CHANNEL].baseline == chosen
        c = judge_runs(RunSource(a), RunSource(a)).comparisons[CHANNEL]
        assert (c.baseline, c.contender) == (f"a:{chosen}", f"b:{chosen}")


def test_the_page_of_two_runs_says_how_to_make_both_again(runs: tuple[Run, Run]) -> None:
    a, b = runs
    context = judge_runs(RunSource(a), RunSource(b), label="arx").context
    assert context.command.endswith("-o RUN_B && flysid compare RUN_A RUN_B --model arx")
    assert "--seed 7 --rules 1" in context.command.split("RUN_A")[0]
    compared = {f for c in context.comparisons.values() for f in c.test.flights}
    assert {facts.id for facts in context.flights} == compared  # its first screen names the logs
    told = context.provenance
    assert told[f"{CHANNEL}: split (run A)"].endswith("held out, seed 7")
    assert told[f"{CHANNEL}: split (run B)"].endswith("held out, seed 13")
    assert told[f"{CHANNEL}: data sha256"] == a.channels[0].split["data_sha256"]  # the same data: said once
    assert told["version of flysid"] == a.versions["flysid"]
    newer = replace(b, versions={**b.versions, "numpy": "9.9"})
    told = judge_runs(RunSource(a), RunSource(newer)).context.provenance
    assert told["version of numpy (run B)"] == "9.9"


def test_flights_of_several_vehicles_are_not_compared_as_one(runs: tuple[Run, Run], tmp_path: Path) -> None:
    folder = tmp_path / "data"
    shutil.copytree(runs[0].data, folder)
    for i, path in enumerate(sorted((folder / "flights").glob("*/manifest.json"))):
        body = json.loads(path.read_text("utf-8"))
        body["info"] |= {"autopilot": "px4", "sys_uuid": f"00060000000037363230323351110{i:02d}"}
        path.write_text(json.dumps(body), "utf-8")
    a, b = (RunSource(run, folder) for run in runs)
    with pytest.raises(UsageError, match=r"flights of \d vehicles") as caught:
        judge_runs(a, b)
    assert "--pool" in str(caught.value.hint)
    pooled = judge_runs(a, b, only=Selection(pool=True))
    assert pooled.comparisons
    said = [c.text for c in pooled.cautions]
    assert any("run A was fitted to px4 " in text and "these flights are of px4 " in text for text in said)
    assert not any("run A was fitted to" in c.text for c in judge_runs(*map(RunSource, runs)).cautions)


def test_channels_of_one_run_only_are_named(runs: tuple[Run, Run], monkeypatch: pytest.MonkeyPatch) -> None:
    def more(run: Run, data: Path | None = None) -> list[HeldOut]:
        (one,) = held_out(run, data)
        return [one, replace(one, channel=replace(one.channel, name="yaw"))] if run == runs[1] else [one]

    monkeypatch.setattr(crossrun, "held_out", more)
    judgement = judge_runs(*map(RunSource, runs))
    assert judgement.skipped == {"yaw": "fitted by run B only"}
    assert judgement.unjudged == ()
    assert judge_runs(*map(RunSource, runs[::-1])).skipped == {"yaw": "fitted by run A only"}


def test_only_flights_held_out_by_both_are_used(runs: tuple[Run, Run]) -> None:
    (c,) = judge_runs(*map(RunSource, runs)).comparisons.values()
    a, b = (held_out(r)[0] for r in runs)
    assert set(c.test.flights) == set(a.test.flights) & set(b.test.flights)
    assert set(c.test.flights) < set(b.test.flights)


def test_without_the_other_runs_data_nothing_is_compared(runs: tuple[Run, Run], tmp_path: Path) -> None:
    a = Path(shutil.copytree(runs[0].folder, tmp_path / "a"))
    moved = replace(runs[0], folder=a, data=str(tmp_path / "gone"))
    with pytest.raises(DataError, match="cannot be ruled out") as caught:
        judge_runs(RunSource(moved), RunSource(runs[1]))
    assert "--data-a" in caught.value.hint
