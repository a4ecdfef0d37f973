"""Documented import paths of earlier releases still lead to their names, and say where those are now."""

from __future__ import annotations

import importlib
import sys

import pytest

import flysid
from flysid.validate.show.page import modelpanels, svg, write_report


def test_the_figure_of_rules_is_found_where_it_was() -> None:
    sys.modules.pop("flysid.validate.rulesfigure", None)
    with pytest.warns(FutureWarning, match=r"is flysid\.draw_rules"):
        old = importlib.import_module("flysid.validate.rulesfigure")
    assert old.draw_rules is flysid.draw_rules


def test_compare_is_found_where_it_was() -> None:
    assert importlib.import_module("flysid.validate.compare_models").compare is flysid.compare


def test_a_figure_of_another_package_finds_what_it_draws_with() -> None:
    sys.modules.pop("flysid.validate.report", None)
    with pytest.warns(FutureWarning, match=r"is flysid\.validate\.show\.page") as told:
        panels = importlib.import_module("flysid.validate.report.modelpanels")
    drawing = importlib.import_module("flysid.validate.report.svg")
    assert (panels.Figure, drawing.picture) == (modelpanels.Figure, svg.picture)
    assert importlib.import_module("flysid.validate.report").write_report is write_report
    assert len(told) == 1
