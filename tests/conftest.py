"""Fixtures that several test modules share."""

from __future__ import annotations

import gc
from collections.abc import Generator, Iterator
from typing import Any

import pytest
from hypothesis import settings

from tests.browser import launch
from tests.contest import linear_side
from tests.doors import tally
from tests.drawn import draw_seed, draws

settings.register_profile("gate", derandomize=True, deadline=None)
settings.register_profile("drawn", deadline=None)
settings.load_profile("drawn" if draws() > 1 else "gate")


RARELY = 20_000
"""New objects between two searches for garbage: Python's 700 costs a twentieth of a test's time."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is imported and collected stays to the end: no search for garbage need walk through it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(RARELY, *gc.get_threshold()[1:])
        gc.enable()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A drawn test is made as often as `tests.drawn.draws` says."""
    if "fresh_seed" in metafunc.fixturenames and draws() > 1:
        metafunc.parametrize("fresh_seed", range(draws()), indirect=True, scope="module")


@pytest.hookimpl(trylast=True)  # the Hypothesis plugin marks its tests before
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Where tests are drawn more than once, those that draw nothing are left out."""
    if draws() == 1:
        return
    plain = [i for i in items if not {"fresh_seed", "hypothesis"} & {*i.fixturenames, *i.keywords}]  # type: ignore[attr-defined]
    config.hook.pytest_deselected(items=plain)
    items[:] = [item for item in items if item not in set(plain)]


@pytest.fixture(scope="module")
def fresh_seed() -> int:
    """Another one in every run; see `tests.drawn`."""
    return draw_seed()


@pytest.fixture
def arx_alone() -> Iterator[None]:
    """ARX alone competes for the baseline and for the rules' linear side; see `tests.contest`."""
    with linear_side("arx"):
        yield


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Chromium without a window; its log has every request and every error of a page."""
    pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium")
    driver = launch(tmp_path_factory.mktemp("profile"))
    driver.set_page_load_timeout(30)
    yield driver
    driver.quit()


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """What the doors cost, where they were among the tests."""
    reports = [
        report for kind in ("passed", "failed", "skipped") for report in terminalreporter.getreports(kind)
    ]
    if costs := tally.lines(report for report in reports if report.when == "call"):
        terminalreporter.section("CPU of the doors")
        terminalreporter.line("\n".join(costs))
