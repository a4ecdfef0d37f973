from pathlib import Path

import pytest
from click.testing import CliRunner

from flysid.cli import root
from flysid.errors import UsageError
from flysid.ingest.align.picture import draw
from tests.flysid.test_tabular import data
from tests.ingest.lake.test_lake import folder  # noqa: F401

pytest.importorskip("matplotlib")


def test_a_picture_shows_every_channel(tmp_path: Path) -> None:
    draw({"roll": data(), "pitch": data(2)}, tmp_path / "p.svg", title="a flight")
    text = (tmp_path / "p.svg").read_text()
    assert text.startswith("<?xml")
    assert "roll: 3 segments" in text or "<use" in text
    draw({"roll": data()}, tmp_path / "p.png")
    assert (tmp_path / "p.png").read_bytes()[:4] == b"\x89PNG"


def test_what_cannot_be_drawn_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="nothing to draw"):
        draw({}, tmp_path / "p.png")
    with pytest.raises(UsageError, match="picture format"):
        draw({"roll": data()}, tmp_path / "p.docx")


def test_show_plot_draws_the_only_recipe_that_fits(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    target = tmp_path / "roll.png"
    done = CliRunner().invoke(root, ["show", str(folder), "--plot", str(target)], catch_exceptions=False)
    assert done.stdout.strip() == str(target)
    assert target.stat().st_size > 5000
    again = CliRunner().invoke(root, ["show", str(folder), "--plot", str(target)])
    assert isinstance(again.exception, UsageError)
