"""The whole way by keyboard alone: a log, channels, a stretch left out, a fit, a verdict, compare, export."""

from __future__ import annotations

import os
import shutil
import signal
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from tests.browser import needs_browser
from tests.flysid.studio.page import Page, until
from tests.flysid.studio.server import SAMPLES, studio

pytestmark = needs_browser

SIZES = [*product((390, 768, 1280), (False, True))] if os.environ.get("FLYSID_ALL_SIZES") else [(390, True)]
"""Width and darkness of the page; the others in `make soak`."""


@pytest.mark.parametrize(("width", "is_dark"), SIZES)
def test_from_a_log_to_a_verdict_by_keys_alone(
    browser: Any, tmp_path: Path, width: int, is_dark: bool
) -> None:
    """The browser's own file dialogue is the one step that the page does not make."""
    browser.set_window_size(width, 1000)
    log = shutil.copy(SAMPLES / "01-multisine-seed1.tlog", tmp_path / "a flight <b>.tlog")
    with studio(tmp_path / "data", module="tests.arx_flysid") as server:
        page = Page(browser, server)
        page.darken(is_dark)
        assert "drop a log" in page.find("#main").text.lower()
        page.tab_to("input[type=file]")
        page.find("input[type=file]").send_keys(str(log))
        until(lambda: page.all(".uplot"), 120)
        assert page.drawn()
        choose(page)
        leave_out_a_stretch(page)
        fit(page)
        page.keys("\ue007")  # the button has the focus: see the verdict
        until(lambda: page.all("iframe"), 60)
        assert "flight" in page.find("tbody").text
        until(lambda: page.all(".explain"), 60)
        assert not page.barriers()
        back_to_the_worst_second(page)
        [run] = (tmp_path / "data.studio" / "runs").iterdir()
        shutil.copytree(run, run.with_name("another"))
        compare(page)
        keep_a_model(page)
        assert not page.wrong()
        page.darken(False)


def choose(page: Page) -> None:
    """The page Channels, its first good cell."""
    page.tab_to("a[data-page=channels]")
    page.keys("\ue007")
    page.ready("channels")
    until(lambda: page.all("td.cell.good button"), 120)
    page.tab_to("td.cell.good button")
    page.keys("\ue007")
    until(lambda: page.all(".strip"), 60)
    for tick in [box.get_attribute("data-cell") for box in page.all("td.cell input:checked")][1:]:
        page.tab_to(f"[data-cell='{tick}']")
        page.keys(" ")


def leave_out_a_stretch(page: Page) -> None:
    for label, seconds in (("From, seconds", "3"), ("To, seconds", "6")):
        page.tab_to(f"[aria-label='{label}']")
        page.js("document.activeElement.select()")
        page.keys(*seconds)
    page.tab_to(".strip + .tools button")
    page.keys("\ue007")
    until(lambda: page.all(".part.out"))
    assert not page.barriers()


def fit(page: Page) -> None:
    """With the quickest models. The page is closed in the middle of it and opened again.

    The verdict is offered when it is there.
    """
    for name in ("polynarx", "static_ts", "ts"):
        if page.js("return document.querySelector(arguments[0]).checked", f"[value={name}]"):
            page.tab_to(f"[value={name}]")
            page.keys(" ")
    page.tab_to(".right > button.main")
    page.keys("\ue007")
    fitting = until(lambda: [j for j in page.server.get("jobs").json["jobs"] if is_fitting(j)])[0]
    os.killpg(fitting["pid"], signal.SIGSTOP)  # else it might be through before the page is back
    try:
        until(lambda: page.all(".job progress"))
        page.go(page.js("return location.hash"))
        until(lambda: page.all(".job progress"))
        assert page.server.get(f"jobs/{fitting['id']}").json["state"] == "running"
    finally:
        os.killpg(fitting["pid"], signal.SIGCONT)
    until(lambda: page.js("return document.activeElement.textContent") == "See the verdict", 300)


def is_fitting(job: Any) -> bool:
    return bool(job["lane"] == "fit" and job["state"] == "running")


def back_to_the_worst_second(page: Page) -> None:
    """The link shows the second in its flight, under the first cursor."""
    page.tab_to(".run a[href^='#/flights']")
    page.keys("\ue007")
    page.ready("flights")
    page.drawn()
    assert "&c=" in page.js("return location.hash")


def compare(page: Page) -> None:
    page.tab_to("a[data-page=runs]")
    page.keys("\ue007")
    page.ready("runs")
    runs = list(dict.fromkeys(box.get_attribute("data-focus") for box in page.all("tbody input")))
    assert len(runs) == 2
    for run in runs:
        page.tab_to(f"[data-focus='{run}']")
        page.keys(" ")
    page.tab_to(".tools button")
    page.keys("\ue007")
    until(lambda: page.all("iframe[title=Comparison]"), 120)


def keep_a_model(page: Page) -> None:
    """Export: the report and the models as files."""
    page.tab_to("td button")
    page.keys("\ue007")
    until(lambda: page.all(".exports"), 60)
    page.tab_to(".exports summary")
    page.keys("\ue007")
    page.tab_to(".exports a[download$='.json'][href*=models]")
    kept = page.js("return document.activeElement.getAttribute('href')")
    model = page.server.raw("GET", kept, headers={"Cookie": page.server.cookie})
    assert model.status == 200
    assert model.json["structure"]
