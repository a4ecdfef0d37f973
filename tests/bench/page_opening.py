"""How large a report is, and how fast a browser opens it: three channels, twelve held-out segments of 75 s.

`python -m tests.bench.page_opening [openings]` fits ARX and a TS model of five rules to simulated flights,
writes the page, and opens it in Debian's chromium. Times are milliseconds from navigation to the load event,
and to the first screen painted.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.ts import TS
from flysid.validate.compare import across_channels, compare
from flysid.validate.report import ReportContext, write_report
from tests.fakes import FirstOrder, flown

TIMES = """const n = performance.getEntriesByType('navigation')[0];
const p = performance.getEntriesByType('paint').find(e => e.name === 'first-contentful-paint');
return [n.loadEventEnd, p ? p.startTime : NaN]"""


def page(folder: Path) -> Path:
    """The report; equal on every machine."""
    comparisons, train = {}, {}
    for i, name in enumerate(("longitudinal", "lateral", "vertical")):
        truth = FirstOrder(a=0.9, b=0.1, d=-0.1 * (i + 1))
        train[name] = flown(truth, [600] * 3, noise=0.02, seed=i)
        models: list[Fitted] = [ARX().fit(train[name]), TS(rules=5, na=2, nb=2, nk=1).fit(train[name])]
        comparisons[name] = compare(
            models, flown(truth, [1500] * 12, noise=0.02, seed=9 + i), train=train[name]
        )
    return write_report(folder / "report.html", ReportContext(across_channels(comparisons), train))


def browser() -> Any:
    """A headless chromium without a profile."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    for flag in ("--headless=new", "--no-sandbox", "--disable-gpu"):
        options.add_argument(flag)
    return webdriver.Chrome(options=options, service=webdriver.ChromeService("/usr/bin/chromedriver"))


def main() -> None:
    """Print the size and every opening."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 9
    with tempfile.TemporaryDirectory() as folder:
        path = page(Path(folder))
        print(f"{path.stat().st_size / 1e6:.2f} MB")
        driver = browser()
        load, paint = [], []
        for _ in range(count):
            driver.get("about:blank")
            driver.get(path.as_uri())
            loaded, painted = driver.execute_script(TIMES)
            load.append(loaded)
            paint.append(painted)
        driver.quit()
    for name, times in (("load event", load), ("first paint", paint)):
        said = ", ".join(f"{t:.0f}" for t in sorted(times))
        print(f"{name}: best {min(times):.0f}, median {statistics.median(times):.0f} ms ({said})")
    print(f"load average {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
