"""Groups of options: declared once, and a verb takes what was given as one value (flysid/cli/options.py)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click
from click.testing import CliRunner

from flysid.cli.options import gather, target_options


@dataclass(frozen=True)
class Size:
    """Two options as one value."""

    width: int
    height: int = 3


size_options = gather("size", Size, click.option("--width", type=int), click.option("--height", default=3))


def test_a_verb_takes_a_group_as_one_value_beside_its_own_options() -> None:
    @click.command()
    @size_options
    @click.option("--name", default="n")
    def command(size: Size, name: str) -> None:
        click.echo(f"{size} {name}")

    done = CliRunner().invoke(command, ["--width", "4", "--name", "x"])
    assert done.output == f"{Size(4, 3)} x\n"
    assert [parameter.name for parameter in command.params] == ["width", "height", "name"]


def test_a_target_is_refused_before_the_verb_runs_and_taken_with_force(tmp_path: Path) -> None:
    @click.command()
    @target_options("-o", "--out", replaced="file")
    def command(out: Path | None) -> None:
        click.echo(f"writes {out}")

    there = tmp_path / "there"
    there.touch()
    runner = CliRunner()
    refused = runner.invoke(command, ["-o", str(there)])
    assert "the target exists" in str(refused.exception)
    assert not refused.output
    assert runner.invoke(command, ["-o", str(there), "--force"]).output == f"writes {there}\n"
    assert runner.invoke(command, []).output == "writes None\n"
