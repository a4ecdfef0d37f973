"""A real browser for tests of pages: Debian's chromium, driven by selenium; `conftest.browser` starts it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
DRIVER = shutil.which("chromedriver")
ONE_PROCESS = (
    "--process-per-site", "--disable-site-isolation-trials",
    "--disable-features=IsolateOrigins,site-per-process,SpareRendererForSitePerProcess",
)  # fmt: skip
"""One site, one process: else every page that is opened begins two."""
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--window-size=1280,1000", "--disable-extensions", *ONE_PROCESS,
)  # fmt: skip

needs_browser = pytest.mark.skipif(
    CHROMIUM is None or DRIVER is None,
    reason="no chromium or chromedriver: apt-get install chromium chromium-driver",
)


def launch(profile: Path, without: tuple[str, ...] = ()) -> Any:
    """Chromium without a window and without some of the flags; its log has every request and every error."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for flag in (*(flag for flag in FLAGS if flag not in without), f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(str(DRIVER)))


def opened(browser: Any, path: Path) -> list[str]:
    """Opens a page; what went wrong: errors in the console, requests that left the file."""
    browser.get_log("performance")
    browser.get_log("browser")
    browser.get(path.as_uri())
    requests = []
    for entry in browser.get_log("performance"):
        message = json.loads(entry["message"])["message"]
        if message["method"] == "Network.requestWillBeSent":
            requests.append(message["params"]["request"]["url"])
    own = (
        path.as_uri(),
        "chrome://",
        "data:",
    )  # the browser's own controls, and what stands in the page, never leave the machine
    left = [f"request {url}" for url in requests if not url.startswith(own)]
    return left + [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
