"""How large a report is, and how fast a browser opens it: three channels, twelve held-out segments of 75 s.

`python -m bench.page_opening [openings]` fits ARX and a TS model of five rules to simulated flights,
writes the page, and opens it in Debian's chromium. Times are milliseconds from navigation to the load event,
and to the first screen painted; an opening that the browser reports no paint of is counted, not guessed.
"""

from __future__ import annotations

import os
import shutil
import statistics
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.ts import TS, over_lags
from flysid.validate.compare.models import across_channels
from flysid.validate.compare_models import compare
from flysid.validate.show.page import ReportContext, write_report
from tests.fakes import FirstOrder, flown

GOAL_MS = 500.0
GOAL_MB = 1.5
PAINT_LIMIT_MS = 5000
# The paint is reported once its frame is on the screen, often after the load event: so it is waited for.
TIMES = """const [limit, done] = arguments, started = performance.now();
const load = () => performance.getEntriesByType('navigation')[0].loadEventEnd;
let painted = null;
new PerformanceObserver(list => {
  for (const e of list.getEntriesByName('first-contentful-paint')) { painted = e.startTime; }
}).observe({type: 'paint', buffered: true});
(function look() {
  if ((painted !== null && load() > 0) || performance.now() - started > limit) { done([load(), painted]); }
  else { setTimeout(look, 10); }
})();"""


def page(folder: Path) -> Path:
    """The report; equal on every machine."""
    comparisons = {}
    train = {}
    for i, name in enumerate(("longitudinal", "lateral", "vertical")):
        truth = FirstOrder(a=0.9, b=0.1, d=-0.1 * (i + 1))
        train[name] = flown(truth, [600] * 3, noise=0.02, seed=i)
        models: list[Fitted] = [ARX().fit(train[name]), over_lags(TS(rules=5, na=2, nb=2, nk=1), train[name])]
        comparisons[name] = compare(
            models, flown(truth, [1500] * 12, noise=0.02, seed=9 + i), train=train[name]
        )
    return write_report(folder / "report.html", ReportContext(across_channels(comparisons), train))


def browser() -> Any:
    """A headless chromium without a profile."""
    from selenium import webdriver

    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    driver = shutil.which("chromedriver")
    if chromium is None or driver is None:
        sys.exit("no chromium or chromedriver: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in ("--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1280,1000"):
        options.add_argument(flag)
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))


def openings(path: Path, count: int) -> list[tuple[float, float | None]]:
    """Load event and first paint of every opening, in ms; None where no paint was reported in time."""
    driver = browser()
    try:
        driver.set_script_timeout(PAINT_LIMIT_MS / 1000 + 10)
        found = []
        for _ in range(count):
            driver.get("about:blank")
            driver.get(path.as_uri())
            loaded, painted = driver.execute_async_script(TIMES, PAINT_LIMIT_MS)
            found.append((float(loaded), None if painted is None else float(painted)))
        return found
    finally:
        driver.quit()


def told(name: str, times: Sequence[float | None]) -> str:
    """ "load event: best 210, median 260, worst 400 ms, goal 500 (210, 260, 400)"; what was not reported."""
    known = sorted(t for t in times if t is not None)
    missing = len(times) - len(known)
    none = f"; none reported within {PAINT_LIMIT_MS / 1000:g} s in {missing} of {len(times)} openings"
    if not known:
        return f"{name}: {none[2:]}"
    said = ", ".join(f"{t:.0f}" for t in known)
    spread = f"best {known[0]:.0f}, median {statistics.median(known):.0f}, worst {known[-1]:.0f} ms"
    return f"{name}: {spread}, goal {GOAL_MS:.0f} ({said}){none if missing else ''}"


def main() -> None:
    """Print the size and every opening."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 21
    before = os.getloadavg()[0]  # the fit below is a load of its own
    with tempfile.TemporaryDirectory() as folder:
        path = page(Path(folder))
        print(f"{path.stat().st_size / 1e6:.2f} MB, goal {GOAL_MB} MB")
        found = openings(path, count)
    print(f"{count} openings, load average {before:.1f} before the fit, {os.getloadavg()[0]:.1f} at the end")
    print(told("load event", [loaded for loaded, _ in found]))
    print(told("first paint", [painted for _, painted in found]))


if __name__ == "__main__":
    main()
