"""`python -m bench.live_heap FOLDER [--minutes 30] [--speed 20]`: memory of the live page on a long flight.

Three channels at 50 Hz, as many samples as so many minutes have, go through the watches of the run in FOLDER
(`bench.watch_cost` makes it) to the live page in a headless Chromium, `--speed` times as fast as flown.
Printed are the page's heap after a collection, and the frames that it draws a second.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from bench.watch_cost import prepared
from flysid.cli.watch import calibrate
from flysid.live.links import open_link
from flysid.live.recording import Recording
from flysid.live.session import Session
from flysid.studio.live_server import serve_live
from flysid.validate.runs.run import held_out, open_run
from tests.browser import launch
from tests.link_trials import free_port

PIECE = 20
LOOKS = 6
FRAMES = """
const [done] = arguments, end = performance.now() + 2000;
let n = 0;
const step = () => { n++; performance.now() < end ? requestAnimationFrame(step) : done(n / 2); };
requestAnimationFrame(step);
"""
ROWS = "return document.querySelector('main').live.charts[0].rows.length"


def heap_mb(browser: Any) -> float:
    """The page's heap after a collection."""
    browser.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
    return float(browser.execute_cdp_cmd("Runtime.getHeapUsage", {})["usedSize"]) / 1e6


def main() -> None:
    """Print the heap now and then."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--speed", type=float, default=20.0)
    options = parser.parse_args()
    run = open_run(prepared(options.folder))
    watches = calibrate(run, None, (), None, 0.1)
    flown = {held.channel.name: held.test.segments[0] for held in held_out(run)}
    with tempfile.TemporaryDirectory() as folder:
        recording = Recording([open_link(f"udp:127.0.0.1:{free_port()}")], Path(folder) / "flight.tlog")
        session = Session(recording, watches)
        session.start()
        told: list[str] = []
        threading.Thread(
            target=serve_live, args=(session, 0, told.append), kwargs={"show": False}, daemon=True
        ).start()
        while not told:
            time.sleep(0.05)
        browser = launch(Path(folder) / "profile")
        browser.get(told[0])
        pieces = round(options.minutes * 60.0 * 50.0 / PIECE)
        began = time.monotonic()
        for k in range(pieces + 1):
            if k % (pieces // LOOKS) == 0:
                time.sleep(1.0)
                rows = browser.execute_script(ROWS)
                frames = browser.execute_async_script(FRAMES)
                minutes = k * PIECE / 3000.0
                print(
                    f"{minutes:5.1f} min: {heap_mb(browser):.2f} MB, {rows} rows, {frames:.0f}/s", flush=True
                )
                began = time.monotonic() - k * PIECE / 50.0 / options.speed
            for watch in watches:
                segment = flown[watch.name]
                first = k * PIECE % (len(segment) - PIECE)
                watch.feed(
                    segment.u[first : first + PIECE], segment.y[first : first + PIECE], k * PIECE / 50.0
                )
            time.sleep(max(0.0, began + k * PIECE / 50.0 / options.speed - time.monotonic()))
        browser.quit()
        session.stop()


if __name__ == "__main__":
    main()
