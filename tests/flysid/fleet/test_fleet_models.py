"""A small fleet from logs to findings: flights are read once, groups fitted, what has changed is found."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import flysid
from bench.fleet_changed import flight_of
from flysid.cli.fleet import command
from flysid.errors import StoreError, UsageError
from flysid.fleet.models.changed import compare
from flysid.fleet.models.changed_page import render
from flysid.fleet.models.common_grid import Sampling
from flysid.fleet.models.differences import flagged, judge, judge_channel
from flysid.fleet.models.flag_words import sizes
from flysid.fleet.models.gather import Gathered, gather
from flysid.fleet.models.group_models import fit_groups
from flysid.fleet.models.triangle_store import Folder, TriangleStore
from flysid.fleet.models.vehicle_runs import fit_vehicles, folder_of
from flysid.ingest.align.recipe import load_recipe
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.chosen_flights import Selection, select
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import Lake
from flysid.ingest.synth.synth import WRITERS, Change, Order, fly_one
from flysid.validate.runs.fitting import fit_run
from flysid.validate.runs.run import FitSettings

RECIPE = load_recipe("px4-effort")
CHANNEL = "throttle_climb"
FLEET = Order("ardrone", "routine", 24.0, seed=1, sensor="autopilot", fleet=8, step_s=0.004,
              changes=(Change(5, 3, "mass", 1.25),))  # fmt: skip


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """Eight vehicles with four flights each; the fifth carries a quarter more from its third flight on."""
    folder = tmp_path_factory.mktemp("fleet")
    suffix, encode = WRITERS["ulog"]
    for i in range(32):
        recording = fly_one(FLEET, i)
        (folder / f"{recording.name}{suffix}").write_bytes(encode(recording))
    list(ingest_logs(find_logs([folder]), folder / "data", jobs=1))
    return flysid.open(folder / "data")


@pytest.fixture(scope="module")
def gathered(lake: Lake) -> Gathered:
    return gather(lake, RECIPE, Folder(lake.folder), (CHANNEL,))


def test_flights_are_read_once(lake: Lake, gathered: Gathered) -> None:
    assert gathered.read == 32
    again = gather(lake, RECIPE, Folder(lake.folder), (CHANNEL,))
    assert again.read == 0
    for one, other in zip(gathered.parts[CHANNEL], again.parts[CHANNEL], strict=True):
        assert one.triangle.r.tobytes() == other.triangle.r.tobytes()
    fewer = gather(lake.only([lake.facts[0].id]), RECIPE, Folder(lake.folder), (CHANNEL,))
    assert [p.flight for p in fewer.parts[CHANNEL]] == [lake.facts[0].id]


@pytest.mark.usefixtures("gathered")
def test_the_same_flights_give_the_same_file(lake: Lake, tmp_path: Path) -> None:
    kept = TriangleStore(Folder(lake.folder), RECIPE).prefix
    gather(lake, RECIPE, Folder(tmp_path), (CHANNEL,))
    names = sorted(p.name for p in (lake.folder / kept).iterdir())
    assert names == sorted(p.name for p in (tmp_path / kept).iterdir())
    for name in names:
        assert (lake.folder / kept / name).read_bytes() == (tmp_path / kept / name).read_bytes()


def test_words_of_a_recipe_do_not_make_other_triangles() -> None:
    spec = replace(RECIPE.channels[CHANNEL], shows="something else")
    reworded = replace(RECIPE, channels={**RECIPE.channels, CHANNEL: spec})
    other = replace(RECIPE, antialias=False)
    here = Folder(Path())
    assert TriangleStore(here, reworded).prefix == TriangleStore(here, RECIPE).prefix
    assert TriangleStore(here, other).prefix != TriangleStore(here, RECIPE).prefix
    assert TriangleStore(here, RECIPE, 20.0).prefix != TriangleStore(here, RECIPE).prefix


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    store = TriangleStore(Folder(tmp_path), RECIPE)
    (tmp_path / store.prefix).mkdir(parents=True)
    (tmp_path / store.prefix / "part-0.parquet").write_bytes(b"no parquet")
    with pytest.raises(StoreError, match="damaged"):
        store.known()
    (tmp_path / store.prefix / f"sampling-{CHANNEL}.json").write_text("{")
    with pytest.raises(StoreError, match="damaged"):
        store.sampling(CHANNEL)


def test_the_changed_vehicle_is_found_and_no_other(lake: Lake, gathered: Gathered) -> None:
    compared = compare(gathered, RECIPE, lake.facts)
    changed = [f for f in compared.findings if f.question == "changed"]
    assert [f.vehicle for f in changed] == ["000005"]
    assert "the same throttle gives" in changed[0].sentence
    assert "less climb than before" in changed[0].sentence
    assert changed[0].since.startswith("v005-03")
    assert -30.0 < changed[0].gain.value < -18.0  # 1 / 1.25, and a battery that sags more under load
    json.dumps(compared.document(), allow_nan=False)
    assert compared.smallest[CHANNEL].gain_pct < 20.0


@pytest.mark.usefixtures("gathered")
def test_vehicles_with_too_few_flights_are_named(lake: Lake) -> None:
    keep = [f.id for f in lake.facts if not f.id.startswith(("v002-02", "v002-03", "v002-04"))]
    fewer = lake.only(keep)
    compared = compare(gather(fewer, RECIPE, Folder(lake.folder), (CHANNEL,)), RECIPE, fewer.facts)
    judged = compared.channels[0]
    assert [compared.names[v] for v in judged.too_few] == ["000002"]
    page = render(compared, "flysid fleet changed")
    assert "Vehicle 000002" in page
    assert "compare the torques" in page  # what the channel cannot show
    assert "too few vehicles to find one" in page
    levels = [int(level) for level in re.findall("<h([1-6])", page)]
    assert all(below - above <= 1 for above, below in pairwise(levels))  # what axe-core calls heading-order


def test_a_date_splits_flights(gathered: Gathered) -> None:
    parts = [replace(p, start_ns=int(p.flight[5:7]) * 10**9) for p in gathered.parts[CHANNEL]]
    judged = judge_channel(CHANNEL, parts, gathered.samplings[CHANNEL], before_ns=2 * 10**9)
    assert {t.flights for t in judged.tests} == {(1, 3)}
    nothing = judge_channel(CHANNEL, parts, gathered.samplings[CHANNEL])
    assert not [t for t in judge([nothing], 0.05)[0].tests if t.flagged and "05" not in t.vehicle]


def test_false_discoveries_are_held(gathered: Gathered) -> None:
    tests = judge_channel(CHANNEL, gathered.parts[CHANNEL], gathered.samplings[CHANNEL]).tests
    for size, passed in ((0.04, 1), (0.2, 0)):
        first = [replace(t, p=(size / len(tests) if i == 0 else 0.9)) for i, t in enumerate(tests)]
        assert sum(t.flagged for t in flagged(first, 0.05)) == passed
    assert flagged([], 0.05) == []


def test_a_size_is_percent_and_milliseconds(gathered: Gathered) -> None:
    test = judge_channel(CHANNEL, gathered.parts[CHANNEL], gathered.samplings[CHANNEL]).tests[0]
    omega = np.array([1.0, 2.0])
    known = replace(test, difference=np.array([0.0, np.log(0.8), 0.0, -0.1]), covariance=1e-6 * np.eye(4))
    gain, delay = sizes(known, omega)
    assert (gain.value, gain.hz) == pytest.approx((-20.0, 1.0 / np.pi))
    assert (delay.value, delay.hz) == pytest.approx((50.0, 1.0 / np.pi))
    assert gain.low < gain.value < gain.high < 0.0 < delay.low < delay.value < delay.high


def test_groups_come_from_triangles(gathered: Gathered) -> None:
    fitted = fit_groups(gathered, ("vehicle", "firmware"))
    assert len(fitted.groups) == 8
    assert {len(g.flights) for g in fitted.groups} == {4}
    document = fitted.document("px4-effort")
    json.dumps(document, allow_nan=False)
    whole = fit_groups(gathered, ()).groups
    assert len(whole) == 1
    assert len(whole[0].flights) == 32
    with pytest.raises(UsageError, match="cannot be grouped"):
        fit_groups(gathered, ("colour",))


@pytest.mark.usefixtures("arx_alone")
def test_runs_of_vehicles_are_those_of_fit(lake: Lake, tmp_path: Path) -> None:
    settings = FitSettings(channels=(CHANNEL,), models=("line",), effort="quick", rotate=False)
    vehicle = next(f.info["sys_uuid"] for f in lake.facts if f.id.startswith("v001"))
    name = f"px4 {vehicle}"
    done = fit_vehicles(lake, "px4-effort", tmp_path, settings, [name], jobs=1)
    assert not isinstance(done[name], str), done[name]
    selection = Selection(vehicle=name)
    fit_run(select(lake, selection), "px4-effort", tmp_path / "plain", replace(settings, selection=selection))
    models = sorted((tmp_path / "plain" / CHANNEL).glob("*.json"))
    assert models
    for path in models:
        assert path.read_bytes() == (tmp_path / folder_of(name) / CHANNEL / path.name).read_bytes()


def test_the_verbs(lake: Lake, tmp_path: Path) -> None:
    runner = CliRunner()
    data = str(lake.folder)
    args = ["-r", "px4-effort", "-c", CHANNEL, "-j", "1"]
    page = ["changed", data, *args, "-o", str(tmp_path / "page")]
    result = runner.invoke(command, [*page, "--fail-if", "changed"], standalone_mode=False)
    assert result.exception is None
    assert result.return_value == 4
    assert "000005: the same throttle gives" in result.stdout
    document = json.loads((tmp_path / "page" / "report.json").read_text("utf-8"))
    assert document["format"] == "flysid-fleet-changed"
    assert "1 of 8 vehicles has changed" in (tmp_path / "page" / "report.html").read_text("utf-8")
    again = runner.invoke(
        command, ["changed", data, *args, "-o", str(tmp_path / "page")], standalone_mode=False
    )
    assert isinstance(again.exception, UsageError)  # it is there already
    fitted = runner.invoke(command, ["fit", data, *args, "--by", "vehicle", "-o", str(tmp_path / "fit")],
                           standalone_mode=False)  # fmt: skip
    assert fitted.return_value == 0
    assert fitted.stdout.count(CHANNEL) == 8
    assert json.loads((tmp_path / "fit" / "fleet.json").read_text("utf-8"))["by"] == ["vehicle"]


def test_flights_in_memory_are_what_the_reader_reads(tmp_path: Path) -> None:
    """The bench flies without writing logs; its tables are those of the log."""
    recording = fly_one(replace(FLEET, duration_s=3.0), 1)
    path = tmp_path / "flight.ulg"
    path.write_bytes(WRITERS["ulog"][1](recording))
    read = flysid.read(path)
    made = flight_of(recording).flight
    assert set(made.tables) <= set(read.tables)
    for name, table in made.tables.items():
        for column in table.column_names:
            one, other = (
                np.array(x[column].to_pylist(), dtype=np.float64) for x in (table, read.tables[name])
            )
            np.testing.assert_array_equal(one, other, err_msg=f"{name}.{column}")


def test_a_sampling_is_kept(tmp_path: Path) -> None:
    store = TriangleStore(Folder(tmp_path), RECIPE)
    sampling = Sampling(0.1, 4, 32, ("u",), ("y",), ("deg", "m/s"))
    assert store.sampling("c") is None
    store.keep_sampling("c", sampling)
    assert store.sampling("c") == sampling
