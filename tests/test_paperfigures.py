"""Figures for a paper: every kind, equal bytes for equal input, harmless names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from flysid.dataset import Signal
from flysid.errors import StoreError, UsageError
from flysid.validate.compare import compare
from flysid.validate.paperfigures import write_figures
from flysid.validate.report import ReportContext
from tests.fakes import FirstOrder, flown
from tests.test_report import compared

pytest.importorskip("matplotlib", reason="pip install matplotlib")


@pytest.mark.parametrize(("kind", "start"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_every_kind_and_equal_bytes(kind: str, start: bytes, tmp_path: Path) -> None:
    context = ReportContext.of({"roll": compared()})
    (one,) = write_figures(tmp_path / "a", context, kind)
    assert one.read_bytes().startswith(start)
    assert one.name == f"channel-1-1.{kind}"
    if kind == "pdf":
        (two,) = write_figures(tmp_path / "b", context, kind)
        assert one.read_bytes() == two.read_bytes()


def test_names_are_text_and_a_linear_contender_gets_its_frequency_response(tmp_path: Path) -> None:
    evil = "$\\frac{$ ../x \x1b"
    signals = (Signal(evil, evil),)
    arx, oe = FirstOrder(b=0.08, outputs=signals), FirstOrder(structure="oe", outputs=signals)
    test = replace(flown(oe, [200], noise=0.02), outputs=signals)
    (path,) = write_figures(tmp_path, ReportContext.of({evil: compare([arx, oe], test)}), "svg")
    text = path.read_text("utf-8")
    assert "gain" in text
    assert "$\\frac{$ ../x" in text
    assert path.parent == tmp_path


def test_wrong_kind_and_folder_are_named(tmp_path: Path) -> None:
    context = ReportContext.of({"roll": compared()})
    with pytest.raises(UsageError, match="'gif' are not known"):
        write_figures(tmp_path, context, "gif")
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError):
        write_figures(tmp_path / "file", context, "svg")
