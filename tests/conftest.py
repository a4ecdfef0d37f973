"""Fixtures that several test modules share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from flysid.model.arx import ARX
from flysid.model.base import Estimator
from flysid.validate import fitting
from tests.browser import launch


@pytest.fixture
def arx_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """ARX alone competes for the baseline, where a test is of the way to a verdict and not of the contest."""

    def only(nk_hint: tuple[int, ...] = ()) -> dict[str, Estimator]:
        return {"arx": ARX(nk_hint=nk_hint)}

    monkeypatch.setattr(fitting, "linear_rivals", only)


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Chromium without a window; its log has every request and every error of a page."""
    pytest.importorskip("selenium.webdriver", reason="selenium is not installed: pip install selenium")
    driver = launch(tmp_path_factory.mktemp("profile"))
    driver.set_page_load_timeout(30)
    yield driver
    driver.quit()
