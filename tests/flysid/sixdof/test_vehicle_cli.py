"""`flysid vehicle`: from a table to vehicle.json, numbers with intervals, and what is wrong in words."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import flysid
from flysid.cli import root
from flysid.dataset import Dataset
from flysid.errors import DataError, FlysidError, RecipeError, UsageError
from tests.flysid.reviews.test_vehicle_page import check_against_document
from tests.flysid.sixdof.hidden_quad import HiddenQuad, write_table
from tests.flysid.sixdof.test_arms import PLACES


def vehicle(*arguments: str | Path) -> Result:
    return CliRunner().invoke(root, ["vehicle", "--no-judge", *map(str, arguments)])


@pytest.fixture(scope="module")
def table(still: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_table(tmp_path_factory.mktemp("tables") / "flight.csv", still, voltage=11.1)


def test_a_table_becomes_a_vehicle(table: Path, tmp_path: Path) -> None:
    arms = tmp_path / "arms.toml"
    arms.write_text("".join(f"motor{i + 1} = [{x}, {y}]\n" for i, (x, y) in enumerate(PLACES)), "utf-8")
    done = vehicle(table, "-o", tmp_path / "vehicle", "--calm", "--arms", arms)
    assert done.exit_code == 0, done.output
    assert "thrust of a motor" in done.stdout
    assert "roll inertia / mass" in done.stdout
    assert "not determined" in done.stdout
    found = flysid.load_vehicle(tmp_path / "vehicle")
    assert found["roll of motor 1"].value == pytest.approx(-HiddenQuad().roll, rel=0.05)
    assert found.places == tuple(map(tuple, PLACES.tolist()))
    exported = tmp_path / "quad.py"
    made = CliRunner().invoke(
        root, ["export", str(tmp_path / "vehicle"), "--to", "rotorpy", "-o", str(exported)]
    )
    assert "mass and arm are taken as 1 kg and 0.13" in made.stderr
    page = (tmp_path / "vehicle/vehicle.html").read_text("utf-8")
    check_against_document(page, json.loads((tmp_path / "vehicle/vehicle.json").read_text("utf-8")))
    assert found.flown_v is not None
    assert found.flown_v[0] < found.reference_v < found.flown_v[1]
    assert isinstance(vehicle(table, "-o", tmp_path / "vehicle").exception, UsageError)


def test_a_page_that_breaks_leaves_the_vehicle(
    short: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ValueError("injected")

    monkeypatch.setattr("flysid.reviews.vehicle_page.render_vehicle", fail)
    table = write_table(tmp_path / "flight.csv", short)
    done = vehicle(table, "-o", tmp_path / "vehicle", "--calm")
    assert done.exit_code == 0, done.output
    assert "The page with its pictures of the vehicle could not be given" in " ".join(done.stderr.split())
    assert "vehicle.html" not in done.stderr
    assert [path.name for path in (tmp_path / "vehicle").iterdir()] == ["vehicle.json"]


def test_rates_and_a_voltage_alone_tell_no_thrust(table: Path, tmp_path: Path) -> None:
    lines = [line.split(",") for line in table.read_text("utf-8").splitlines()]
    kept = [i for i, name in enumerate(lines[0]) if name.startswith(("time", "motor", "gyro", "voltage"))]
    bare = tmp_path / "bare.csv"
    bare.write_text("\n".join(",".join(line[i] for i in kept) for line in lines), "utf-8")
    done = vehicle(bare, "-o", tmp_path / "vehicle")
    assert done.exit_code == 0, done.output
    assert "voltage power: no velocity and no accelerometer are logged" in " ".join(done.stdout.split())


def test_two_logs_are_one_vehicle_and_json_holds_it(short: Dataset, tmp_path: Path) -> None:
    paths = []
    (segment,) = short.segments
    half = len(segment) // 2
    for i in range(2):
        part = short.with_segments([segment.slice(half * i, half * (i + 1), short.dt_s)])
        paths.append(write_table(tmp_path / f"{i}.csv", part))
    done = vehicle(*paths, "--json", "-q", "--pool")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert len(document["flights"]) == 2
    assert {row["name"] for row in document["numbers"] if row["is_determined"]} >= {"motor lag"}


def test_pulses_and_axes_are_found_and_said(short: Dataset, tmp_path: Path) -> None:
    segment = short.segments[0]
    y = segment.y * np.repeat([1.0, -1.0, 1.0, -1.0, 1.0], [1, 2, 1, 2, 10])
    half = y[:, 6:10].copy()
    y[:, 6:10] = np.stack([-half[:, 1], half[:, 0], half[:, 3], -half[:, 2]], axis=1)
    pulses = replace(segment, u=1000.0 + 1000.0 * segment.u, y=y)
    done = vehicle(write_table(tmp_path / "pulses.csv", short.with_segments([pulses])), "--calm")
    assert done.exit_code == 0, done.output
    assert "pulses" in done.stdout
    assert "forward, right, down" in done.stdout


@pytest.mark.parametrize(
    ("change", "kind", "words"),
    [
        (lambda names: [n.replace("motor", "m") for n in names], RecipeError, "no commands of motors"),
        (lambda names: [n.replace("gyro", "rate") for n in names], RecipeError, "no gyro"),
    ],
)
def test_what_is_not_logged_is_named(
    table: Path, tmp_path: Path, change: object, kind: type[FlysidError], words: str
) -> None:
    head, _, rest = table.read_text().partition("\n")
    assert callable(change)
    other = tmp_path / "other.csv"
    other.write_text(",".join(change(head.split(","))) + "\n" + rest)
    done = vehicle(other)
    assert isinstance(done.exception, kind)
    assert words in str(done.exception)


def test_motors_that_stand_still_are_no_flight(table: Path, tmp_path: Path) -> None:
    lines = table.read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    still = [",".join([row[0], "0", "0", "0", "0", *row[5:]]) for row in rows]
    other = tmp_path / "bench.csv"
    other.write_text("\n".join([lines[0], *still]) + "\n")
    done = vehicle(other)
    assert isinstance(done.exception, DataError)
    assert "no motors turn" in str(done.exception)


def test_a_fleet_has_a_vehicle_for_every_name(table: Path, tmp_path: Path) -> None:
    lines = [line.split(",") for line in table.read_text("utf-8").splitlines()]
    kept = [i for i, name in enumerate(lines[0]) if name.startswith(("time", "motor", "gyro"))]
    rows = [[line[i] for i in kept] for line in lines]
    still = [rows[0], *([row[0], "0", "0", "0", "0", *row[5:]] for row in rows[1:])]
    logs = {"v1/a": rows[: len(rows) // 2], "v2/b": rows[:1] + rows[len(rows) // 2 :], "v3/c": still}
    for name, log in logs.items():
        path = tmp_path / f"logs/{name}.csv"
        path.parent.mkdir(parents=True)
        path.write_text("".join(",".join(row) + "\n" for row in log), "utf-8")
    data, fleet = tmp_path / "data", tmp_path / "fleet"

    def run(*words: object) -> Result:
        return CliRunner().invoke(root, [str(word) for word in words], standalone_mode=False)

    taken = run("ingest", tmp_path / "logs", "-o", data, "--vehicle-in", "v[0-9]", "-q")
    assert taken.return_value == 0, taken.output
    done = run("fleet", "fit", data, "-r", "sixdof", "--vehicle", "-o", fleet)
    assert done.return_value == 3, done.output
    assert "v3: no motors turn in these logs" in done.stderr
    assert sorted(path.name for path in fleet.iterdir()) == ["v1", "v2"]
    alone = run("vehicle", data, "--vehicle", "v2", "-o", tmp_path / "alone")
    assert alone.return_value == 0, alone.output
    assert (fleet / "v2/vehicle.json").read_bytes() == (tmp_path / "alone/vehicle.json").read_bytes()
    shown = {line.split()[0]: line for line in done.stdout.splitlines()}
    found = flysid.load_vehicle(fleet / "v1")["motor lag"]
    assert f"{found.value:.3g} +- {found.half_width:.1g}" in shown["v1"]
    again = run("fleet", "fit", data, "-r", "sixdof", "--vehicle", "-o", fleet)
    assert isinstance(again.exception, UsageError)
    assert "the target exists" in str(again.exception)
