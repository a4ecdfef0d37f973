"""The page in a real browser: by mouse and by keyboard, narrow and wide, and what it computes by itself."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flysid.model.start import run_from_window
from flysid.validate.runs.run import held_out, open_run
from tests.browser import launch, needs_browser
from tests.flysid.studio.page import Page, until
from tests.flysid.studio.server import SAMPLES, Server, studio

pytestmark = needs_browser


@pytest.fixture
def page(browser: Any, server: Server) -> Iterator[Page]:
    browser.set_window_size(1280, 1000)
    found = Page(browser, server)
    yield found
    assert not found.wrong()


def test_a_flight_opens_with_its_first_pair_drawn(page: Page) -> None:
    assert page.drawn()
    assert len(page.all(".plot .uplot")) == 1
    assert "roll" in page.find(".plot .head").text or "v_" in page.find(".plot .head").text
    inked = "const c = document.querySelector('.uplot canvas'); const d = c.getContext('2d')"
    inked += ".getImageData(0, 0, c.width, c.height).data; let n = 0;"
    inked += "for (let i = 3; i < d.length; i += 4) { n += d[i] > 0; } return n;"
    assert page.js(inked) > 1000


def test_zoom_is_linked_kept_in_the_address_and_comes_back(page: Page) -> None:
    tree = page.find(".tree details")
    tree.find_element("css selector", "summary").click()
    until(lambda: page.all(".tree details[open] li button"))[0].click()
    until(lambda: len(page.all(".uplot")) == 2)
    before = page.drawn()
    page.js("document.querySelector('.chart').focus()")
    page.keys("+", "+")
    until(lambda: page.drawn() != before)
    window = page.settled()
    scales = "return [...document.querySelectorAll('.plot .uplot')].length"
    assert page.js(scales) == 2
    address = page.js("return location.hash")
    assert "t=" in address
    canvases = "return [...document.querySelectorAll('.uplot canvas')].map(c => c.toDataURL())"
    picture = page.js(canvases)
    page.go(address)
    until(lambda: page.drawn() == window)
    until(lambda: page.js(canvases) == picture)


def test_curves_of_an_address_are_asked_for_once(page: Page) -> None:
    """With the flight, before it is known; neither the width nor the first plots' appearing ask again."""
    page.find(".tree details summary").click()
    until(lambda: page.all(".tree details[open] li button"))[0].click()
    until(lambda: len(page.all(".uplot")) == 2)
    page.drawn()
    page.go(page.js("return location.hash"))
    page.drawn()
    asked = page.js("return performance.getEntriesByType('resource').map(entry => entry.name)")
    assert sum("/series?" in name for name in asked) == 1


def test_a_scroll_bar_takes_no_width_that_curves_were_asked_for(server: Server, tmp_path: Path) -> None:
    """It appears with the plots; the first curves, asked for before, fit beside it."""
    browser = launch(tmp_path, without=("--hide-scrollbars",))
    try:
        page = Page(browser, server)
        page.find(".tree details summary").click()
        for button in until(lambda: page.all(".tree details[open] li button"))[:6]:
            button.click()
        until(lambda: len(page.all(".uplot")) > 5)
        page.drawn()
        page.go(page.js("return location.hash"))
        page.drawn()
        bar = "const work = document.querySelector('.work'); return work.offsetWidth - work.clientWidth"
        assert page.js(bar) > 0
        asked = page.js("return performance.getEntriesByType('resource').map(entry => entry.name)")
        assert sum("/series?" in name for name in asked) == 1
    finally:
        browser.quit()


def test_the_last_of_many_zooms_is_what_is_drawn(page: Page) -> None:
    from selenium.webdriver.common.keys import Keys

    page.drawn()
    page.js("document.querySelector('.chart').focus()")
    ways = ["+", "-", Keys.ARROW_LEFT, Keys.ARROW_RIGHT]
    page.keys("+", "+", *random.Random(3).choices(ways, k=100))
    assert page.settled()


def test_a_plot_is_made_and_read_by_keyboard_alone(page: Page) -> None:
    from selenium.webdriver.common.keys import Keys

    count = len(page.all(".uplot"))
    page.js("document.body.focus()")
    page.keys("/", "r", "o", "l", "l")
    assert page.js("return document.activeElement.value") == "roll"
    first = until(lambda: page.js("return document.querySelector('.tree details[open] li button')"))
    for _ in range(4):
        page.keys(Keys.TAB)
        if page.js("return document.activeElement.dataset.field"):
            break
    assert first is not None
    page.keys(Keys.ENTER)
    until(lambda: len(page.all(".uplot")) == count + 1)
    page.js("document.querySelector('.plot:last-of-type .chart').focus()")
    page.keys(".", ".", ">", ">")
    text = page.find(".reading").text
    assert "between cursors" in text
    page.keys("x")
    until(lambda: len(page.all(".uplot")) == count)


@pytest.mark.parametrize("width", [390, 768, 1280])
@pytest.mark.parametrize("where", ["#/flights", "#/channels", "#/runs", "#/jobs"])
def test_nothing_sticks_out(page: Page, where: str, width: int) -> None:
    page.browser.set_window_size(width, 900)
    page.js("document.cookie = ''")
    page.go(where)
    inner, scrolled = page.js("return [innerWidth, document.documentElement.scrollWidth]")
    assert scrolled <= inner + 1
    for is_dark in (False, True):
        page.darken(is_dark)
        assert not page.barriers()
    page.darken(False)


def test_a_page_that_is_left_while_it_loads_leaves_nothing(page: Page, server: Server) -> None:
    """No event stream stays open, no drop is taken twice, the address and the screen are the next page's."""
    page.drawn()
    jobs = server.get("jobs").json["jobs"]
    flight = server.get("flights").json["flights"][0]["id"]
    job = server.wait(server.get(f"flights/{flight}/suggestions").json.get("job") or jobs[0]["id"])
    page.js(
        "window.opened = []; const Real = EventSource;"
        "EventSource = class extends Real { constructor(...a) { super(...a); opened.push(this); }"
        " addEventListener() {} };"  # it is never told that the job has ended
        "const real = fetch; window.asked = 0;"
        "window.go = new Promise(done => { window.free = done; });"
        "fetch = async (...a) => { if (/jobs/.test(a[0])) { asked++; await go; } return real(...a); };"
    )
    page.js("location.hash = arguments[0]", f"#/jobs?j={job['id']}")
    until(lambda: page.js("return asked"))
    page.js("location.hash = '#/runs'")
    page.ready("runs")
    page.js("free()")
    until(lambda: page.js("return opened.length"))
    assert page.js("return opened.every(x => x.readyState === EventSource.CLOSED)")
    assert page.js("return location.hash") == "#/runs"
    assert page.find("h1").text == "Runs"
    assert len(page.all("main .work")) == 1


def test_a_log_that_changes_while_it_is_sent(browser: Any, tmp_path: Path) -> None:
    """The browser gives up the file; the page says so, and nothing is kept of it."""
    log = tmp_path / "growing.tlog"
    whole = (SAMPLES / "01-multisine-seed1.tlog").read_bytes()
    log.write_bytes(whole[:100_000])
    with studio(tmp_path / "data") as server:
        page = Page(browser, server)
        page.js("const real = fetch; fetch = async (...a) => { await window.go; return real(...a); };")
        page.js("window.go = new Promise(done => { window.free = done; })")
        page.find("input[type=file]").send_keys(str(log))
        time.sleep(1.1)  # the browser compares times of files, of a second on some disks
        log.write_bytes(whole)
        page.js("window.free()")
        assert "changed or removed" in until(lambda: page.find("#error").text)
        assert server.get("flights").json["count"] == 0
        assert not list((tmp_path / "data.studio" / "uploads").iterdir())


def test_from_the_job_to_the_verdict_explained(browser: Any, judged: Server) -> None:
    """The command, the verdict and its scope, the report in its frame; the page's free run is Python's."""
    browser.set_window_size(1280, 1000)
    page = Page(browser, judged)
    job = judged.get("jobs").json["jobs"][-1]
    page.go("#/jobs?j=" + job["id"])
    assert "flysid fit" in until(lambda: page.find(".command").text)
    until(lambda: "done after" in page.find(".job [role=status]").text)
    page.go("#/runs?pick=newest")
    [run] = judged.get("runs").json["runs"]
    assert run["channels"][0]["scope"] in page.find("tbody").text
    until(lambda: page.all("iframe"))
    page.find(".explain summary").click()
    until(lambda: len(page.all(".explain .uplot")) == 2)
    until(lambda: page.all(".explain h2"))
    page.js("document.querySelector('[aria-label=\"Added to the input\"]').value = '0.3'")
    next(b for b in page.all(".explain button") if b.text == "Fly it").click()
    flown = page.js("return document.querySelector('.explain > div > div:last-child').flown")
    assert not page.wrong()
    shown = page.js("return document.querySelector('[aria-label=\"Held-out segment\"]').value")
    data = judged.get(f"runs/{run['id']}/explanation", {"ch": "vertical", "segment": shown}).json
    [item] = held_out(open_run(run["folder"]))
    segment = item.test.segments[int(shown)]
    first = data["first"]
    u = segment.u.copy()
    moved = np.arange(len(u)) * item.test.dt_s >= round(first * item.test.dt_s, 2)
    u[moved, 0] += 0.3
    assert set(flown) == set(data["models"])
    for label, outputs in flown.items():
        model = item.models[label]
        expected = run_from_window(model, replace(segment, u=u), first)[first:]
        assert np.abs(np.array(outputs) - expected).max() < 1e-9 * max(1.0, float(np.ptp(segment.y)))


def test_a_flight_opens_with_its_review(page: Page) -> None:
    until(lambda: page.all(".answer .headline"))
    assert page.find(".answer .headline").text
    page.find(".answer details summary").click()
    assert page.all(".answer tbody tr")


def test_an_empty_studio_offers_a_flight(browser: Any, tmp_path: Path) -> None:
    with studio(tmp_path / "data") as empty:
        page = Page(browser, empty)
        until(lambda: page.all("main button"))
        [offer] = [button for button in page.all("main button") if "simulated flight" in button.text]
        offer.click()
        until(lambda: page.all(".answer .headline"))
        assert page.find("h1").text.endswith(".ulg")
        assert page.drawn()
        assert not page.wrong()
