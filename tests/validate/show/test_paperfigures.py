"""Figures for a paper: every kind, equal bytes for equal input, harmless names."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from flysid.dataset import FloatArray, Signal
from flysid.errors import UsageError
from flysid.model.arx import ARX
from flysid.validate.compare.comparison import Comparison
from flysid.validate.compare_models import compare
from flysid.validate.show.page import ReportContext
from flysid.validate.show.page.describe import Page, describe
from flysid.validate.show.paperfigures import figure_files
from tests.fakes import FirstOrder, flown
from tests.validate.show.page.test_report import compared
from tests.validate.show.page.test_report_mimo import flights

pytest.importorskip("matplotlib", reason="pip install matplotlib")


def page_of(**comparisons: Comparison) -> Page:
    return describe(ReportContext.of(comparisons))


@pytest.mark.parametrize(("kind", "start"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_every_kind_and_equal_bytes(kind: str, start: bytes) -> None:
    page = page_of(roll=compared())
    files = figure_files(page, kind)
    assert list(files) == [f"channel-1-1.{kind}"]
    assert files[f"channel-1-1.{kind}"].startswith(start)
    if kind == "pdf":
        assert figure_files(page, kind) == files


def test_names_are_text_and_a_linear_contender_gets_its_frequency_response() -> None:
    evil = "$\\frac{$ ../x \x1b"
    signals = (Signal(evil, evil),)
    arx = FirstOrder(b=0.08, outputs=signals)
    oe = FirstOrder(structure="oe", outputs=signals)
    test = replace(flown(oe, [200], noise=0.02), outputs=signals)
    files = figure_files(page_of(**{evil: compare([arx, oe], test)}), "svg")
    assert list(files) == ["channel-1-1.svg"]
    text = files["channel-1-1.svg"].decode()
    assert "gain" in text
    assert "$\\frac{$ ../x" in text


def test_every_output_is_drawn_with_the_input_that_moves_it() -> None:
    train = flights(3, 0)
    models = {"arx": ARX(na=1, nb=1, refine=False).fit(train), "oe": ARX(na=1, nb=2, refine=False).fit(train)}
    files = figure_files(page_of(body=compare(models, flights(2, 1))), "svg")
    one, two = (files[f"channel-1-{j}.svg"].decode() for j in (1, 2))
    assert (">phi<" in one, ">theta<" in one) == (True, False)
    assert (">phi<" in two, ">theta<" in two) == (False, True)


@dataclass(frozen=True, eq=False)
class WithSets(FirstOrder):
    """Two sets over the last output."""

    @property
    def antecedents(self) -> tuple[str, ...]:
        return ("y(k-1)",)

    def memberships(self, variable: int, x: FloatArray) -> FloatArray:
        del variable
        return np.stack([np.exp(-((x - c) ** 2)) for c in (-1.0, 1.0)], axis=1)


def test_fuzzy_sets_carry_their_names() -> None:
    ts = WithSets(structure="ts", labels=("R1", "R2"))
    c = compare([FirstOrder(b=0.08), ts], flown(ts, [200] * 2, noise=0.02))
    (drawn,) = figure_files(page_of(roll=c), "svg").values()
    assert all(f">{name}<" in drawn.decode() for name in ("A1", "A2", "y(k-1), m/s"))


def test_a_wrong_kind_is_named() -> None:
    page = page_of(roll=compared())
    with pytest.raises(UsageError, match=r"no picture format '\.gif'"):
        figure_files(page, "gif")
