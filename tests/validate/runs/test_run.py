"""From an ingested folder to a run, a judgement and a report; and back from disk."""

from __future__ import annotations

import csv
import json
import re
import shutil
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from flysid.cli.demo import meaning
from flysid.cli.fit import transfer_lines
from flysid.cli.output import end_comparison
from flysid.dataset import Signal
from flysid.errors import DataError, StoreError, UsageError
from flysid.files import replacing_folder, write_atomically
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.chosen_flights import Selection
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.lake.stretches import Stretches
from flysid.ingest.synth.synth import WRITERS, Order, flights
from flysid.model.anfis import ANFIS
from flysid.model.arx import ARX
from flysid.model.base import Estimator, Fitted, load
from flysid.model.ensemble import Ensemble
from flysid.model.oe import OE
from flysid.model.ts import TS
from flysid.showing import number
from flysid.split import Split
from flysid.validate.compare.comparison import Comparison, Entry
from flysid.validate.compare.models import sides_of
from flysid.validate.compare_models import compare
from flysid.validate.runs import fitting, judge
from flysid.validate.runs.expected import expected_of_run
from flysid.validate.runs.fitone import nothing_done
from flysid.validate.runs.fitting import fit_run
from flysid.validate.runs.judge import Judgement, judge_run
from flysid.validate.runs.run import FitSettings, HeldOut, Run, held_out, open_run, requested_model
from flysid.validate.runs.wanted_models import estimators
from flysid.validate.show.finish import finish, write_finished
from flysid.validate.show.page import render
from tests.contest import linear_side
from tests.fakes import FirstOrder, fields_of, flown

CHANNEL = "longitudinal"


@pytest.fixture(scope="module", autouse=True)
def two_candidates() -> Iterator[None]:
    """ARX and OE alone compete for the baseline here; a run of tests/flysid/studio has them all."""
    with linear_side("arx", "oe"):
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six flights of 20 s of the linear plants, in both formats, ingested."""
    root = tmp_path_factory.mktemp("flights")
    for i, recording in enumerate(flights(Order(duration_s=20.0))):
        suffix, encode = (WRITERS["tlog"], WRITERS["mcap"])[i % 2]
        write_atomically(root / f"{recording.name}{suffix}", encode(recording))
    list(ingest_logs(find_logs([root]), root / "data"))
    return root / "data"


@pytest.fixture(scope="module")
def run(data: Path) -> Run:
    settings = FitSettings(channels=(CHANNEL,), rules=2, effort="quick", rotate=False, remark="as flown")
    return fit_run(open_lake(data), "ardrone-synthetic", data.parent / "run", settings)


@pytest.fixture(scope="module")
def judgement(run: Run) -> Judgement:
    """Of the run as it reads back from disk."""
    return judge_run(open_run(run.folder))


@pytest.fixture(scope="module")
def turned(data: Path) -> Run:
    """With orders given: six fits of everything."""
    settings = FitSettings(channels=(CHANNEL,), models=("line",))
    given: dict[str, Estimator] = {"arx": ARX(na=2, nb=2, nk=1, refine=False), "oe": OE(na=1, nb=1, nk=1)}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "linear_rivals", lambda *_: given)
        return fit_run(open_lake(data), "ardrone-synthetic", data.parent / "turned", settings)


@pytest.fixture
def copied(run: Run, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run.folder, tmp_path / "run"))


def test_a_run_reads_back_as_it_was_written(run: Run) -> None:
    assert open_run(run.folder) == run


def test_the_held_out_part_is_made_again_and_was_never_trained_on(run: Run) -> None:
    (held,) = held_out(run)
    assert set(held.models) >= {"mean", "persistence", "line", "arx", "oe", "static_ts", "ts"}
    assert held.channel.baseline in held.models
    assert not set(held.train.flights) & set(held.test.flights)
    assert len(held.test) / (len(held.train) + len(held.test)) == pytest.approx(0.3, abs=0.12)


def test_a_run_keeps_what_stands_above_every_report_on_it(judgement: Judgement, run: Run) -> None:
    """The demo's page lost "simulated flights" when `validate` made it again."""
    assert judgement.context.remark == "as flown"
    only = Selection(stretches=Stretches(between="0..15"))
    assert judge_run(run, only=only).context.remark == "as flown; judged with --between 0..15"


def test_all_six_flights_are_judged_by_models_that_have_not_seen_them(turned: Run) -> None:
    """Two would be held out; they take turns instead, and the models of the run stay those of the split."""
    assert open_run(turned.folder) == turned
    (held,) = held_out(turned)
    assert len(held.test.flights) <= 4
    assert len(held.turns) == 5
    left_out = [flight for turn in held.turns for flight in turn.test.flights]
    assert sorted(left_out) == sorted({*held.train.flights, *held.test.flights})
    for fold, turn in zip(held.channel.folds, held.turns, strict=True):
        split = Split.from_dict(fold.split)
        assert not {p.segment for p in split.train} & {p.segment for p in split.test}
        assert set(turn.models) == set(held.models)
        assert turn.models["arx"] != held.models["arx"]
        assert set(turn.both.flights) == set(held.train.flights) - set(turn.test.flights)
    judgement = judge_run(turned)
    pair = judgement.document["channels"][CHANNEL]["free_run"]["pairs"]["line"]
    assert (pair["scope"], pair["units"], pair["unit"]) == ("another flight of this day", 6, "flights")
    assert len(pair["by_flight"]) == 6
    assert pair["verdict"] == "worse"
    assert "each of 6 flights was left out once and judged by models fitted to the others" in pair["reason"]
    page = render(judgement.context)
    assert "ach of 6 flights was left out once and judged by models fitted to the others" in page
    assert "How far these are from the models shown and saved, those of the split, is taken off" in page


def test_without_rotation_two_flights_are_judged_and_said_to_be_few(judgement: Judgement) -> None:
    document = judgement.document
    pair = document["channels"][CHANNEL]["free_run"]["pairs"]["ts"]
    assert (pair["scope"], pair["units"]) == ("another flight of this day", 2)
    assert any("Only 2 held-out flights" in c["text"] for c in document["cautions"])


def test_the_judgement_finds_a_linear_model_enough_on_a_linear_plant(run: Run, judgement: Judgement) -> None:
    free = judgement.document["channels"][CHANNEL]["free_run"]
    assert free["verdict"] in ("same", "worse")
    assert free["models"]["arx"]["rmse"] == pytest.approx(0.02, rel=0.15)  # the noise that was flown
    assert free["models"]["line"]["rmse"] > 3 * free["models"]["arx"]["rmse"]
    assert set(judgement.document["channels"][CHANNEL]) >= {"free_run", "10", "1"}
    json.dumps(judgement.document, allow_nan=False)
    expected = expected_of_run(open_run(run.folder))
    assert fields_of(expected["channels"]) == fields_of(judgement.document["channels"])
    assert expected["skipped"] == judgement.document["skipped"]


def test_a_model_is_read_once_for_a_condition_and_the_judgement(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = open_run(run.folder)
    read: list[Path] = []

    def counted(path: str | Path) -> Fitted:
        read.append(Path(path))
        return load(path)

    monkeypatch.setattr("flysid.validate.runs.run.load", counted)
    expected_of_run(opened)
    held_out(opened)
    files = {f for c in opened.channels for f in c.models.values()}
    files |= {f for c in opened.channels for fold in c.folds for f in fold.models.values()}
    assert len(read) == len(set(read)) == len(files)


def test_the_report_is_written_whole_and_says_where_it_came_from(
    run: Run, judgement: Judgement, tmp_path: Path
) -> None:
    page = write_finished(finish(judgement, page=True), tmp_path / "report")
    text = page.read_text("utf-8")
    assert "flysid fit DATA --recipe ardrone-synthetic" in text
    assert str(open_run(run.folder).channels[0].split["test_sha256"]) in text
    assert page.stat().st_size < 1_500_000
    assert [p.name for p in tmp_path.iterdir()] == ["report"]


def test_other_forms_of_the_judgement_tell_the_same_numbers(judgement: Judgement) -> None:
    rmse = judgement.document["channels"][CHANNEL]["free_run"]["models"]["arx"]["rmse"]
    finished = finish(judgement)
    rows = list(csv.DictReader(finished.text("csv").splitlines()))
    arx = [r for r in rows if (r["horizon"], r["model"], r["segment"]) == ("free_run", "arx", "")]
    assert [float(r["rmse"]) for r in arx] == [rmse]
    assert json.loads(finished.text("json")) == judgement.document
    assert f"| arx | {number(rmse)} m/s |" in finished.text("markdown")
    grave = [c.text for c in judgement.cautions if c.level in ("danger", "warning")]
    told = " ".join(finished.table.split())  # folded to the width of a terminal
    assert [text for text in grave if told.count(f"caution: {text} Try: ") != 1] == []
    assert told.count("caution: ") == len(grave)
    assert all(text in finished.text("markdown").replace("\\", "") for text in grave)
    held = judgement.comparisons[CHANNEL]
    still = replace(held.test, segments=tuple(replace(s, u=0.0 * s.u) for s in held.test.segments))
    quiet = replace(judgement, comparisons={CHANNEL: compare(held.fitted, still, baseline=held.baseline)})
    assert "caution: No input of" in finish(quiet).table
    with pytest.raises(UsageError, match="no form 'docx'"):
        finished.text("docx")


def test_channels_that_are_not_judged_are_named_everywhere(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    skipped = replace(run, skipped={"yaw": "no <yaw> command"})
    judgement = judge_run(skipped)
    page = write_finished(finish(judgement, page=True), tmp_path / "report").read_text("utf-8")
    assert "<b>Not judged: yaw</b>: no &lt;yaw&gt; command" in page
    assert "- **yaw**: not judged: no \\<yaw\\> command" in finish(judgement).text("markdown")
    assert end_comparison(finish(judgement), None, None, quiet=True) == 0  # the fit has spoken of it
    assert "channel yaw not judged: no <yaw> command" in capsys.readouterr().err

    def short(*_: object, **__: object) -> Comparison:
        raise DataError("too short")

    other = judgement.comparisons[CHANNEL]
    monkeypatch.setattr(judge, "held_out", lambda *_: [*held_out(run), *_renamed(run, "yaw")])
    monkeypatch.setattr(judge, "compare_models", lambda _, test, **__: other if test.name else short())
    lost = judge_run(run)
    assert (lost.unjudged, lost.skipped) == (("yaw",), {"yaw": "too short"})
    assert end_comparison(finish(lost), None, None, quiet=True) == 3
    assert end_comparison(finish(lost), "free_run.models.arx.rmse > 0", None, quiet=True) == 4
    monkeypatch.setattr(judge, "compare_models", short)
    nothing = f"no channel of recipe 'ardrone-synthetic' could be judged: {CHANNEL}, yaw: too short$"
    with pytest.raises(DataError, match=nothing):
        judge_run(run)


def test_data_that_moved_and_models_that_are_gone_say_what_to_do(copied: Path, tmp_path: Path) -> None:
    moved = replace(open_run(copied), data=str(tmp_path / "gone"))
    with pytest.raises(UsageError, match="fitted on are missing") as caught:
        judge_run(moved)
    assert "--data" in caught.value.hint
    (copied / CHANNEL / "ts.json").unlink()
    with pytest.raises(StoreError, match="a model of the run is missing") as lost:
        judge_run(open_run(copied))
    assert lost.value.hint == "fit it again"


def test_the_headline_is_about_the_model_that_was_asked_for(run: Run) -> None:
    (held,) = held_out(run)
    linear = {label: m for label, m in held.models.items() if label != "ts"}
    assert requested_model(("line", "oe"), held.models, "arx") is None  # ts is there
    assert requested_model(("line", "oe"), linear, "arx") == "oe"
    assert requested_model(("line", "oe"), linear, "oe") is None
    assert sides_of(linear, "arx").contender in ("oe", "static_ts")  # never the line
    assert sides_of({n: linear[n] for n in ("arx", "line")}, "arx").contender == "line"


def test_the_demo_says_what_a_loss_means(judgement: Judgement) -> None:
    arx = FirstOrder()
    ts = FirstOrder(b=0.07, structure="ts", labels=("R1", "R2"))
    lost = compare([arx, ts], flown(arx, [300] * 6, noise=0.02))
    won = compare(
        [replace(ts, structure="arx"), replace(arx, structure="ts", labels=("R1", "R2"))], lost.test
    )
    assert lost.verdict["y"].verdict == "worse"
    assert meaning(replace(judgement, comparisons={"a": lost})).startswith("One linear model")
    both = {"a": lost, "b": replace(won, entries=tuple(_of_z(e) for e in won.entries))}
    told = meaning(replace(judgement, comparisons=both))
    assert told.startswith("Rules help on z; on y a linear model is enough.")


def test_alignment_is_told_line_by_line(run: Run) -> None:
    (channel,) = run.channels
    told = replace(run, channels=(replace(channel, aligned=("two flights", "the band; trust no other")),))
    assert (
        judge_run(told).context.provenance[f"{CHANNEL}: alignment"] == "two flights; the band, trust no other"
    )


def _of_z(entry: Entry) -> Entry:
    return replace(entry, output=Signal("z", "m/s"))


def _renamed(run: Run, name: str) -> list[HeldOut]:
    return [
        replace(h, channel=replace(h.channel, name=name), test=replace(h.test, name=""))
        for h in held_out(run)
    ]


def test_figures_without_matplotlib_name_the_extra_and_leave_nothing(
    judgement: Judgement, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(UsageError, match=r"flysid\[plot\]"):
        finish(judgement, page=True, figures="pdf")
    assert list(tmp_path.iterdir()) == []


def test_every_model_has_its_rules_in_words_beside_it(run: Run) -> None:
    for file in run.channels[0].models.values():
        assert "\n  " in (run.folder / file).with_suffix(".txt").read_text("utf-8")
    linear = (run.folder / CHANNEL / "arx.txt").read_text("utf-8").splitlines()
    assert re.match(r"arx, \d+ parameters$", linear[0])
    assert re.match(r"  \* One more deg of theta_in adds \S+ m/s to v_x; 63 % of that is reached", linear[1])
    assert linear[2].startswith("  v_x(k) = ")
    words = (run.folder / CHANNEL / "ts.txt").read_text("utf-8")
    assert words.startswith("ts, ")
    assert "\n  R1. If " in words
    assert "\n  R2. If " in words
    assert "v_x(k) = " in words
    level = r"-?\d+(?:\.\d+)?"
    known = rf"{level} m/s \({level} to {level}\)"
    answer = (
        rf"one more deg of theta_in adds {known} to v_x; 63 % of that is reached after {level} s \({level} to"
    )
    assert re.match(rf"  \* (From|Near) v_x = .*, {answer}", words.splitlines()[1])
    assert re.search(
        rf"\n  R\d\. If .*; at rest near v_x = {level} m/s: (gain {level} m/s per deg|as R1)", words
    )


def test_two_fits_give_the_same_files(data: Path, run: Run, tmp_path: Path) -> None:
    again = fit_run(open_lake(data), "ardrone-synthetic", tmp_path / "again", run.settings)
    for file in run.channels[0].models.values():
        assert (tmp_path / "again" / file).read_bytes() == (run.folder / file).read_bytes()
    assert again.channels[0].split == run.channels[0].split


def test_data_that_changed_since_the_fit_is_noticed(copied: Path, data: Path, tmp_path: Path) -> None:
    moved = tmp_path / "data"
    shutil.copytree(data, moved)
    shutil.rmtree(next((moved / "flights").iterdir()))
    with pytest.raises(DataError, match="hash differs"):
        held_out(open_run(copied), moved)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 99}, "version 99"),
        ({"format": "other"}, "not a flysid run"),
        ({"channels": [{"name": "x"}]}, "damaged"),
        ({"settings": {"nonsense": 1}}, "damaged"),
    ],
)
def test_a_run_of_another_version_or_damaged_is_refused(
    copied: Path, change: dict[str, object], message: str
) -> None:
    document = json.loads((copied / "run.json").read_text())
    (copied / "run.json").write_text(json.dumps(document | change))
    with pytest.raises(StoreError, match=message):
        open_run(copied)


def test_a_run_cannot_name_files_outside_its_folder(copied: Path) -> None:
    document = json.loads((copied / "run.json").read_text())
    document["channels"][0]["models"] = {"arx": "../../etc/passwd"}
    (copied / "run.json").write_text(json.dumps(document))
    with pytest.raises(StoreError, match="leads out of the folder"):
        held_out(open_run(copied))


def test_a_model_file_of_another_version_is_refused(copied: Path) -> None:
    path = copied / CHANNEL / "arx.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"version": 2}))
    with pytest.raises(StoreError, match="version 2"):
        held_out(open_run(copied))


def test_what_is_asked_for_must_exist(data: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no channel 'yaw'"):
        fit_run(open_lake(data), "ardrone-synthetic", tmp_path / "run", FitSettings(channels=("yaw",)))
    with pytest.raises(UsageError, match="no such run folder"):
        open_run(tmp_path / "absent")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_a_run_says_what_was_meant(copied: Path, data: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for folder, hint in (
        (data, "this is an ingested folder"),
        (tmp_path, f"did you mean '{copied}'?"),
        (tmp_path / "empty", "make one with 'flysid fit"),
    ):
        with pytest.raises(StoreError, match=r"not a run: it has no run\.json") as caught:
            open_run(folder)
        assert hint in caught.value.hint


def test_a_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "out"
    with replacing_folder(target) as folder:
        (folder / "a").write_text("1")
        assert not target.exists()
    with pytest.raises(IsADirectoryError), replacing_folder(target) as folder:
        folder.write_text("a folder is not a file")
    assert (target / "a").read_text() == "1"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_segments_too_short_for_the_grid_are_named_and_nothing_is_left(data: Path, tmp_path: Path) -> None:
    recipe = tmp_path / "tiny.toml"
    text = (Path(__file__).parents[3] / "ingest/align/recipes/ardrone-synthetic.toml").read_text()
    recipe.write_text("rate_hz = 0.5\n" + text)
    with pytest.raises(DataError, match=r"longitudinal: .*no segment of 20 samples"):
        fit_run(
            open_lake(data), str(recipe), tmp_path / "run", FitSettings(channels=(CHANNEL,), rotate=False)
        )
    assert [p.name for p in tmp_path.iterdir()] == ["tiny.toml"]


def test_other_models_are_fitted_on_request(data: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no model 'arxx'"):
        fit_run(open_lake(data), "ardrone-synthetic", tmp_path / "run", FitSettings(models=("arxx",)))
    settings = FitSettings(channels=(CHANNEL,), models=("tf",), rotate=False)
    run = fit_run(open_lake(data), "ardrone-synthetic", tmp_path / "run", settings)
    assert {"mean", "arx", "oe", "tf"} <= set(run.channels[0].models)
    assert not {"ts", "static_ts"} & set(run.channels[0].models)
    assert run.channels[0].loops == ()
    text = "\n".join(transfer_lines(run, run.channels[0]))
    assert "v_x / theta_in =" in text
    assert "+-" in text
    judgement = judge_run(open_run(run.folder))
    free = judgement.document["channels"][CHANNEL]["free_run"]
    assert free["models"]["tf"]["rmse"] < 1.1 * free["models"]["arx"]["rmse"]
    write_finished(finish(judgement, page=True), tmp_path / "report")


def test_every_label_makes_an_estimator_that_knows_what_was_asked_for() -> None:
    settings = FitSettings(rules=2, antecedents=("v_x(k-1)",), models=("anfis", "ensemble"), rotate=False)
    found = estimators(settings, "arx", ((4,), ()))
    anfis = found["anfis"]
    ensemble = found["ensemble"]
    assert isinstance(anfis, ANFIS)
    assert isinstance(ensemble, Ensemble)
    assert (anfis.rules, anfis.nk, anfis.antecedents) == (2, 4, ("v_x(k-1)",))
    assert ensemble.of == TS(rules=2, antecedents=("v_x(k-1)",), nk_hint=(4,), states=0)
    free = estimators(FitSettings(models=("anfis",)))["anfis"]
    assert free == ANFIS()


def test_of_channels_that_fail_alike_the_reason_and_the_advice_are_said_once() -> None:
    why = "condition 'armed' never holds Try: choose what was flown"
    error = nothing_done(
        "r", "fitted", {"roll": f"channel 'roll': {why}", "pitch": f"channel 'pitch': {why}", "yaw": "no"}
    )
    assert error.message == (
        "no channel of recipe 'r' could be fitted: roll, pitch: condition 'armed' never holds; yaw: no"
    )
    assert error.hint == "choose what was flown"
