"""`flysid watch VEHICLE LOG`: a weak motor and a heavier vehicle are named, the same vehicle is not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from click.testing import CliRunner, Result

from flysid.cli import root
from flysid.errors import UsageError
from flysid.sixdof.changes import MASS, changes_since, compare
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.layout import EFFECTS, ROTOR_DRAG, THRUST
from tests.flysid.sixdof.hidden_quad import HiddenQuad, dataset, write_table

QUAD = HiddenQuad()


def watch(*arguments: str | Path) -> Result:
    return CliRunner().invoke(root, ["watch", *map(str, arguments)], standalone_mode=False)


def test_the_same_vehicle_shows_no_change(regressed: FittedVehicle) -> None:
    found = changes_since(regressed, dataset(QUAD, 1, 15.0, 50))
    assert found.found == []
    assert {"motor 1", "motor 4", MASS} <= {row.name for row in found.rows}
    assert "no change of motor 1" in found.lines()[0]


def test_a_weak_motor_is_named(regressed: FittedVehicle, tmp_path: Path) -> None:
    regressed.save(tmp_path / "vehicle.json")
    weak = replace(QUAD, strength=(1.0, 1.0, 0.75, 1.0))
    log = write_table(tmp_path / "weak.csv", dataset(weak, 1, 15.0, 51))
    done = watch(tmp_path, log, "--fail", "--json")
    assert done.return_value == 6, done.output
    rows = {row["name"]: row for row in json.loads(done.stdout)["changes"]}
    assert rows["motor 3"]["low"] < 0.75 < rows["motor 3"]["high"]
    assert [name for name, row in rows.items() if row["is_change"] and name.startswith("motor ")] == [
        "motor 3"
    ]


def test_a_heavier_vehicle_is_named_in_words(regressed: FittedVehicle, tmp_path: Path) -> None:
    regressed.save(tmp_path / "vehicle.json")
    heavy = write_table(
        tmp_path / "heavy.csv", dataset(replace(QUAD, thrust=QUAD.thrust / 1.25), 1, 15.0, 52)
    )
    done = watch(tmp_path / "vehicle.json", heavy)
    assert done.return_value == 0, done.output
    told = " ".join(done.stdout.split())
    assert f"{MASS}: " in told
    assert "% of mass would do" in told
    assert "propeller" not in told


def test_what_a_named_change_explains_is_not_named_again(regressed: FittedVehicle) -> None:
    def later(place: int, factor: float) -> FittedVehicle:
        theta = regressed.theta.copy()
        theta[place] *= factor
        return replace(regressed, theta=theta)

    heavy = later(THRUST, 1.0 / 1.25)
    heavy.theta[ROTOR_DRAG : ROTOR_DRAG + 2] /= 1.25
    assert [row.name for row in compare(regressed, heavy).found] == [MASS]
    weak = later(THRUST, 0.93)
    weak.theta[[EFFECTS + axis * 4 for axis in range(3)]] *= 0.72
    assert [row.name for row in compare(regressed, weak).found] == ["motor 1"]


def test_a_link_is_no_log(regressed: FittedVehicle, tmp_path: Path) -> None:
    regressed.save(tmp_path / "vehicle.json")
    done = watch(tmp_path, "udp:14550")
    assert isinstance(done.exception, UsageError)
    assert "not on a link" in str(done.exception)
