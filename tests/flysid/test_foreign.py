"""Paths in documents of others lead nowhere but into their own folders, for every kind of document."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flysid import mirror, store
from flysid.errors import FlysidError, StoreError
from flysid.foreign import inner_path, why_outside
from flysid.manifest import read_manifest
from flysid.validate.runs.run import open_run
from tests.command import call
from tests.flysid.test_public_names import a_vehicle
from tests.released_files import released

SECRET = "root:x:0:0"
OUTER = [
    "../../secret",
    "/etc/passwd",
    "C:\\secret",
    "\\\\host\\share",
    "~/secret",
    "s3://b/x",
    "",
    "a/../../../secret",
]


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A stranger's run and data, and beside them what is nobody's business."""
    for name in ("run", "data"):
        shutil.copytree(released()[-1] / name, tmp_path / "strangers" / name)
    (tmp_path / "strangers" / "flight.tlog").touch()
    (tmp_path / "secret").write_text(SECRET)
    return tmp_path / "strangers"


@pytest.mark.parametrize("name", [*OUTER, None, 3, "x\0y", "a" * 5000])
def test_a_name_that_leads_out_is_refused_with_its_document(tmp_path: Path, name: object) -> None:
    with pytest.raises(StoreError) as caught:
        inner_path(tmp_path, name, tmp_path / "run.json")
    assert "entry" in caught.value.message
    assert caught.value.where == str(tmp_path / "run.json")


def test_links_and_devices_are_refused_and_what_is_inside_is_not(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    (inside / "deep").mkdir(parents=True)
    (inside / "deep" / "file").write_text("")
    (inside / "near").symlink_to("deep/file")
    (inside / "up").symlink_to("..")
    (inside / "far").symlink_to("/etc/passwd")
    (inside / "gone").symlink_to(tmp_path / "not yet")
    (inside / "round").symlink_to("round")
    (inside / "zero").symlink_to("/dev/zero")
    os.mkfifo(inside / "pipe")
    for name in ("deep/file", "near", "deep", "not yet", "a..b", "..."):
        assert inner_path(inside, name, "x.json") == inside / name
    for name in ("up/secret", "far", "gone", "zero", "pipe", "up"):
        with pytest.raises(StoreError):
            inner_path(inside, name, "x.json")
    (tmp_path / "link").symlink_to("inside")
    assert inner_path(tmp_path / "link", "near", "x.json").read_text() == ""  # the user chose the link


def test_a_reason_is_given_for_every_kind_of_name() -> None:
    assert {why_outside(name) for name in OUTER} == {
        "leads out of the folder",
        "is an absolute path, not one below the folder",
        "is an address, not a file below the folder",
        "is no file name",
    }


def in_run(place: Path, name: str) -> None:
    path = place / "run" / "run.json"
    body = json.loads(path.read_text())
    for channel in body["channels"]:
        channel["models"] = dict.fromkeys(channel["models"], name)
    path.write_text(json.dumps(body))


def in_manifest(place: Path, name: str) -> None:
    for path in (place / "data" / "flights").glob("*/manifest.json"):
        body = json.loads(path.read_text())
        for stream in body["streams"]:
            stream["file"] = name
        path.write_text(json.dumps(body))


def in_id(place: Path, name: str) -> None:
    for path in (place / "data" / "flights").glob("*/manifest.json"):
        path.write_text(json.dumps({**json.loads(path.read_text()), "id": name}))


def in_recipe(place: Path, name: str) -> None:
    path = place / "run" / "recipe.toml"
    path.unlink()
    path.symlink_to(place / "run" / name)


def in_report(place: Path, name: str) -> None:
    path = place / "run" / "report" / "report.json"
    path.unlink()
    path.symlink_to(place / "run" / name)


@pytest.mark.parametrize("name", ["../../secret", "/etc/passwd"])
@pytest.mark.parametrize(
    ("spoil", "words", "said"),
    [
        (in_run, ("validate", "run", "--data", "data", "-o", "page"), "run.json"),
        (in_run, ("watch", "run", "flight.tlog", "--data", "data"), "run.json"),
        (in_run, ("export", "run", "--c", "out"), "run.json"),
        (in_run, ("design", "run", "--data", "data"), "run.json"),
        (in_recipe, ("validate", "run", "--data", "data", "-o", "page"), "recipe.toml"),
        (in_recipe, ("plan", "run", "--data", "data", "-o", "page"), "recipe.toml"),
        (in_report, ("runs", "."), "report.json"),
        (in_manifest, ("export", "data", "--flight", "01", "1.1/ATTITUDE", "-o", "x.csv"), "manifest.json"),
        (in_manifest, ("fit", "data", "-r", "ardrone-synthetic", "-o", "new", "-q"), "manifest.json"),
        (in_manifest, ("plot", "data", "1.1/ATTITUDE.roll", "-o", "x.html"), "manifest.json"),
        (in_id, ("ls", "data"), "manifest.json"),
        (in_id, ("show", "data", "01", "1.1/ATTITUDE"), "manifest.json"),
    ],
)
def test_no_verb_follows_a_document_out_of_its_folder(
    place: Path, spoil: Callable[[Path, str], None], words: tuple[str, ...], said: str, name: str
) -> None:
    spoil(place, name)
    done = call(*words, cwd=place)
    assert done.returncode != 0
    assert said in done.stderr
    assert SECRET not in done.stdout + done.stderr
    assert not any((place / target).exists() for target in ("page", "out", "x.csv", "x.html", "new"))


DEEP = "[" * 100_000 + "]" * 100_000


@pytest.mark.parametrize(
    ("where", "text", "said"),
    [
        (("settings",), '"../../secret"', "Expected `object`, got `str` - at `$.settings`"),
        (("channels", 0, "models"), '"=1+1"', "got `str` - at `$.channels[0].models`"),
        (("channels", 0, "aligned"), "[3]", "got `int` - at `$.channels[0].aligned[0]`"),
        (("channels", 0, "fit_seconds"), '{"ts": "nan"}', "got `str` - at `$.channels[0].fit_seconds"),
        (("channels", 0, "name"), "NaN", "not a flysid run: not JSON"),
        (("versions",), DEEP, "not a flysid run: not JSON"),
    ],
)
def test_an_entry_of_another_type_is_named(
    place: Path, where: tuple[str | int, ...], text: str, said: str
) -> None:
    path = place / "run" / "run.json"
    path.write_text(spoilt(json.loads(path.read_text()), where, text))
    done = call("validate", "run", "--data", "data", "-o", "page", cwd=place)
    assert done.returncode == 2
    assert said in done.stderr
    assert "run.json" in done.stderr


def spoilt(body: Any, where: tuple[str | int, ...], text: str) -> str:
    """A document with this text in the place of one of its entries."""
    at = body
    for key in where[:-1]:
        at = at[key]
    at[where[-1]] = "the place"
    return json.dumps(body).replace('"the place"', text)


@pytest.mark.parametrize(
    ("where", "text", "said"),
    [
        (("held",), "[]", "not a vehicle"),
        (("held",), '{"99": "why"}', "not a vehicle: 4 motors have 34 numbers"),
        (("held",), DEEP, "not a vehicle: not JSON"),
        (("flown_v",), f"[1, {10**400}]", "not a vehicle"),
        (("notes",), '"one"', "not a vehicle: Expected `array`, got `str`"),
        (("command_full",), "0", "not a vehicle: commands from 0 over 0"),
        (("reference_v",), "0", "not a vehicle: a reference of 0 V"),
        (("dt_s",), "-1", "not a vehicle: a sample time of -1 s"),
        (("command_zero",), "Infinity", "not a vehicle: not JSON"),
    ],
)
def test_a_vehicle_of_a_stranger_is_checked_before_it_is_used(
    tmp_path: Path, where: tuple[str | int, ...], text: str, said: str
) -> None:
    (tmp_path / "vehicle.json").write_text(spoilt(a_vehicle().to_dict(), where, text))
    done = call("export", "vehicle.json", "--to", "c", "-o", "new.h", cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert not (tmp_path / "new.h").exists()


@pytest.mark.parametrize("verb", [("export", "folder", "--to", "c"), ("fly", "folder")])
def test_vehicles_and_designs_that_are_links_or_pipes_are_refused(
    tmp_path: Path, verb: tuple[str, ...]
) -> None:
    (tmp_path / "folder").mkdir()
    for name in ("vehicle.json", "design.json"):
        (tmp_path / name).write_text(SECRET)
        (tmp_path / "folder" / name).symlink_to(f"../{name}")
    done = call(*verb, cwd=tmp_path)
    assert "is a link that leads out of the folder" in done.stderr
    for name in ("vehicle.json", "design.json"):
        (tmp_path / "folder" / name).unlink()
        os.mkfifo(tmp_path / "folder" / name)
    done = call(*verb, cwd=tmp_path)
    assert (done.returncode, "a device, a pipe or a socket" in done.stderr) == (2, True)


def test_a_device_in_a_run_ends_at_once(place: Path) -> None:
    for name in ("run.json", "recipe.toml"):
        (place / "run" / name).unlink()
        os.mkfifo(place / "run" / name)
    done = call("validate", "run", cwd=place)
    assert done.returncode == 2
    assert "a device, a pipe or a socket" in done.stderr


def test_an_index_that_is_a_pipe_is_none(place: Path) -> None:
    for index in (place / "data" / ".catalogue", place / "data" / ".mirror", place / ".flysid-runs.parquet"):
        index.unlink(missing_ok=True)
        os.mkfifo(index)
    assert "01-multisine" in call("ls", "data", cwd=place).stdout
    assert call("show", "data", "03", cwd=place).returncode == 2
    assert "vertical" in call("runs", ".", cwd=place).stdout


def test_writers_do_not_remove_what_a_link_leads_to(place: Path, tmp_path: Path) -> None:
    precious = tmp_path / "home" / "precious" / "file"
    precious.parent.mkdir(parents=True)
    precious.write_text("mine")
    shutil.rmtree(place / "data" / "flights")
    (place / "data" / "flights").symlink_to("../../home")
    (place / "log.csv").write_text("time,x\n" + "".join(f"{k / 50},{k % 7}\n" for k in range(200)))
    done = call("ingest", "log.csv", "-o", "data", cwd=place)
    assert done.returncode == 2
    assert "is a link that leads out of the folder" in done.stderr
    assert precious.read_text() == "mine"
    assert [p.name for p in (tmp_path / "home").iterdir()] == ["precious"]


def test_a_report_is_not_left_where_a_link_leads_to(place: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    shutil.rmtree(place / "run" / "report")
    (place / "run" / "report").symlink_to(elsewhere)
    call("validate", "run", "--data", "data", "-o", "page", "-q", cwd=place)
    assert not list(elsewhere.iterdir())


def test_only_the_cache_mirrors_a_lake(place: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked: list[str] = []
    monkeypatch.setattr(mirror, "_bring", lambda place, *_: asked.append(str(place)))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (place / "data" / ".mirror").write_text("s3://strangers/lake")
    flight = next((place / "data" / "flights").iterdir())
    (flight / "manifest.json").unlink()
    with pytest.raises(FlysidError):
        read_manifest(flight)
    assert not asked
    own = store.mirror_of("s3://own/lake")
    with pytest.raises(FlysidError):
        read_manifest(own / "flights" / "log-0123456789abcdef")
    assert asked == ["s3://own/lake"]


def test_a_released_run_is_read_as_before(place: Path) -> None:
    run = open_run(place / "run")
    assert all(run.model(file) for channel in run.channels for file in channel.models.values())


def test_targets_that_are_links_to_nothing_are_not_written_through(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time_s,x\n0,1\n1,2\n2,3\n")
    (tmp_path / "out.csv").symlink_to(tmp_path / "elsewhere")
    done = call("export", "log.csv", "x", "-o", "out.csv", cwd=tmp_path)
    assert done.returncode == 2
    assert not (tmp_path / "elsewhere").exists()
