"""Documented import paths of earlier releases still lead to their names, and say where those are now."""

from __future__ import annotations

import importlib
import sys

import pytest

import flysid


def test_the_figure_of_rules_is_found_where_it_was() -> None:
    sys.modules.pop("flysid.validate.rulesfigure", None)
    with pytest.warns(FutureWarning, match=r"is flysid\.draw_rules"):
        old = importlib.import_module("flysid.validate.rulesfigure")
    assert old.draw_rules is flysid.draw_rules


def test_compare_is_found_where_it_was() -> None:
    assert importlib.import_module("flysid.validate.compare_models").compare is flysid.compare
