"""The page Channels in a real browser: stretches left out and held out, recipes both ways, two fields."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.browser import needs_browser
from tests.flysid.studio.page import Page, until
from tests.flysid.studio.server import Server

pytestmark = needs_browser


@pytest.fixture
def page(browser: Any, server: Server) -> Iterator[Page]:
    browser.set_window_size(1280, 1000)
    found = Page(browser, server)
    found.go("#/channels?r=ardrone-synthetic")
    until(lambda: len(found.all(".strips .strip")) == 2)  # both flights are looked at: nothing moves any more
    found.all("td.cell.good button")[0].click()
    until(lambda: found.all(".opened .strip"))
    yield found
    assert not found.wrong()


def command(page: Page) -> str:
    return str(page.js("return document.querySelector('.command')?.textContent || ''"))


def test_a_drag_leaves_out_and_with_shift_holds_out(page: Page) -> None:
    """On the strip and on a plot; the signals go, the command says it, the address brings it back."""
    before = page.all(".opened .strip .used")
    page.drag(page.find(".opened .strip"), 0.3, 60)
    until(lambda: page.all(".opened .strip .out"))
    assert len(page.all(".opened .strip .used")) == len(before) + 1
    page.drag(page.all(".uplot .u-over")[1], 0.7, 120, shift=True)
    until(lambda: "--holdout" in command(page))
    assert command(page).count("--exclude") == 1
    assert command(page).count("--holdout") == 1
    assert "@0:" in command(page)
    told = command(page)
    page.go(page.js("return location.hash"))
    until(lambda: page.all(".opened .strip .held"), 60)
    assert until(lambda: command(page)) == told
    assert not page.barriers()
    for _ in range(2):
        page.find(".part").click()
    until(lambda: "--exclude" not in command(page) and "--holdout" not in command(page))
    until(lambda: len(page.all(".opened .strip .used")) == len(before))


def test_a_part_is_left_out_by_its_seconds(page: Page) -> None:
    fields = page.all(".strip + .tools input")
    for field, seconds in zip(fields, ("3", "6"), strict=True):
        page.js("arguments[0].value = arguments[1]", field, seconds)
    page.all(".strip + .tools button")[0].click()
    until(lambda: page.all(".opened .strip .out"))
    assert "--exclude" in until(lambda: command(page))


def test_every_ticked_flight_has_a_strip(page: Page) -> None:
    """What is dragged over on one is left out of that flight alone."""
    page.drag(page.all(".strips .strip")[1], 0.3, 60)
    until(lambda: len(page.all(".strips .strip .out")) == 1)
    [part] = page.js("return new URLSearchParams(location.hash.split('?')[1]).getAll('x')")
    log = page.all(".matrix tbody th")[1].text
    assert part.startswith(log.rpartition(".")[0])
    ticks = f"[data-cell^='tick {part.partition('@')[0]}|']:checked"
    while boxes := page.all(ticks):  # the table is drawn anew with every tick
        boxes[0].click()
    until(lambda: len(page.all(".strips .strip")) == 1)


def test_a_recipe_is_changed_as_a_form_and_as_toml(page: Page) -> None:
    page.find(".recipe > summary").click()
    text = until(lambda: page.js("return document.querySelector('.recipe textarea').value"))
    assert 'inputs = ["vz_in"]' in text
    change = "const [box, value] = arguments; box.value = value; box.dispatchEvent(new Event('change'))"
    form = ".recipe .two > div:first-child"
    page.js(change, page.find(f"{form} > label input"), 'quoted "words"')
    until(lambda: 'quoted \\"words\\"' in page.find(".recipe textarea").get_property("value"))
    written = page.find(".recipe textarea").get_property("value")
    page.js(change, page.find(".recipe textarea"), written.replace("[channels.vertical]", "[channels.up]"))
    until(lambda: "channel up" in page.js("return document.querySelector(arguments[0]).textContent", form))
    page.js(change, page.find(".recipe textarea"), written.replace("inputs", "imputs", 1))
    assert "inputs" in until(lambda: page.find(".recipe [role=status]").text)
    assert not page.barriers()
    refused = [e for e in page.browser.get_log("browser") if "api/1/recipes" not in e["message"]]
    assert not refused


def test_two_dragged_fields_are_fitted(page: Page) -> None:
    """From this field to that: two fields of the tree, dropped on the ends."""
    page.go("#/flights")
    page.drawn()
    logged = "[...document.querySelectorAll('.tree details')].find(x => x.textContent.includes('Hz'))"
    page.js(f"{logged}.querySelector('summary').click()")
    until(lambda: len(page.all(".tree details[open] li")) > 1)
    page.carry(".tree details[open] li:nth-child(1) button", ".side form label:nth-of-type(1) input")
    page.carry(".tree details[open] li:nth-child(2) button", ".side form label:nth-of-type(2) input")
    page.js("document.querySelector('.side form').requestSubmit()")
    page.ready("channels")
    told = until(lambda: command(page))
    assert "--from" in told
    assert "--to" in told
    assert "--recipe" not in told
