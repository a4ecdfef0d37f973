"""The page of a review in a real browser: what a click shows, narrow and wide, and nothing from elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from flysid.reviews.page import write_review
from tests.browser import needs_browser, opened
from tests.flysid.reviews.test_page import some_review
from tests.flysid.studio.page import until

pytestmark = needs_browser


@pytest.fixture
def page(browser: Any, tmp_path: Path) -> Any:
    path = write_review(tmp_path / "review.html", [some_review()])
    browser.set_window_size(1280, 1000)
    assert opened(browser, path) == []
    return browser


def test_a_figure_shows_its_second(page: Any) -> None:
    page.find_element("css selector", '.go[data-field="t.x"]').click()
    shown = page.find_element("css selector", "section.flight")
    assert float(shown.get_attribute("data-from")) == pytest.approx(7.5)
    assert float(shown.get_attribute("data-to")) == pytest.approx(17.5)


def test_an_event_shows_its_second(page: Any) -> None:
    page.find_element("css selector", ".wide .go").click()
    shown = page.find_element("css selector", "section.flight")
    assert float(shown.get_attribute("data-from")) == pytest.approx(7.5)


@pytest.mark.parametrize("width", [390, 768, 1280])
def test_nothing_is_wider_than_the_screen(page: Any, width: int) -> None:
    page.set_window_size(width, 900)
    fits = "return document.documentElement.scrollWidth <= window.innerWidth"
    until(lambda: page.execute_script(fits), 10.0)  # curves follow the screen when they are told of it


def test_a_keyboard_reaches_every_figure(page: Any) -> None:
    bare = "return [...document.querySelectorAll('a, button')].filter(one => !one.textContent.trim()).length"
    assert page.execute_script(bare) == 0
    pictures = page.find_elements("css selector", "svg[role=img]")
    assert all(one.get_attribute("aria-label") for one in pictures)
