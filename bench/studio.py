"""What the studio takes: to answer, to the paint, a zoom, a dropped log, ten people at once.

    python -m bench.studio [--samples 1e6] [--log FILE] [--people 10]

Wall times, best, median and 95th percentile: an idle machine is asked for; its load is printed. Chromium and
chromedriver draw. The fields are made here; --log is dropped on the page.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from flysid.flight import BOOT, TIME, ClockMap, Damage, Source
from flysid.store import create_data_folder, write_flight
from tests.browser import launch
from tests.flysid.studio.server import Server, studio

PIXELS = 1200
ROWS = 1 << 20
PERIOD_NS = 1_000_000


class Part:
    """Some rows of the stream `made`."""

    stream = "made"

    def __init__(self, table: pa.Table) -> None:
        self.table = table


class Ended:
    """What a reader knows at its end."""

    damage = Damage()
    info: dict[str, str] = {}  # noqa: RUF012

    def __init__(self, samples: int) -> None:
        self.clocks = (ClockMap(0, 0, (samples - 1) * PERIOD_NS),)


def make_flight(data: Path, samples: int) -> None:
    """Three fields of random walks at 1 kHz, one with a spike of one sample."""

    def parts() -> Iterator[Part]:
        rng = np.random.default_rng(1)
        for start in range(0, samples, ROWS):
            rows = np.arange(start, min(start + ROWS, samples))
            columns = {name: np.cumsum(rng.normal(size=len(rows))) for name in "abc"}
            columns["a"][rows == samples // 2] = 1e5
            boots = pa.array(np.zeros(len(rows)), pa.int32())
            yield Part(pa.table({TIME: rows * PERIOD_NS, BOOT: boots, **columns}))

    def reading() -> Any:
        yield from parts()
        return Ended(samples)

    create_data_folder(data)
    write_flight(data, Source("made.bin", "dataflash", 0, "0" * 64), reading())


def timed(action: Callable[[], Any]) -> float:
    """Seconds of wall time."""
    began = time.perf_counter()
    action()
    return time.perf_counter() - began


def told(name: str, seconds: Sequence[float], goal: str) -> None:
    """One line: best, median, 95th percentile."""
    high = float(np.percentile(seconds, 95))
    middle = statistics.median(seconds)
    print(
        f"{name:58} best {min(seconds):.3f}  median {middle:.3f}  p95 {high:.3f} s  (goal {goal})", flush=True
    )


def resident_mb(server: Server) -> float:
    """Anonymous and mapped memory of the server."""
    pages = int(Path(f"/proc/{server.process.pid}/statm").read_text("utf-8").split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 1e6


def over_http(server: Server, samples: int) -> None:
    """Three fields, cold and warm, and windows of any size."""
    flight = server.get("flights").json["flights"][0]["id"]
    asked: dict[str, Any] = {"f": flight, "s": ["made:a", "made:b", "made:c"], "w": PIXELS}
    told(f"3 x {samples:.0e} over HTTP, cold", [timed(lambda: server.get("series", asked))], "")
    told("the same, warm", [timed(lambda: server.get("series", asked)) for _ in range(20)], "")
    end = samples * PERIOD_NS * 1e-9
    rng = np.random.default_rng(2)
    sizes = []
    seconds = []
    for _ in range(100):
        low, high = np.sort(rng.uniform(0, end, 2))
        began = time.perf_counter()
        sizes.append(len(server.get("series", asked | {"t0": low, "t1": high + 0.01}).body))
        seconds.append(time.perf_counter() - began)
    told("100 windows of any size over HTTP", seconds, "")
    print(
        f"largest answer {max(sizes) / 1e3:.0f} kB (goal 100); server {resident_mb(server):.0f} MB",
        flush=True,
    )


def painted(browser: Any, action: str) -> float:
    """Seconds from an action in the page to the frame after the newest answer is drawn."""
    script = (
        "const done = arguments[arguments.length - 1], list = document.querySelector('[data-drawn]');"
        "const began = performance.now(), before = list ? list.dataset.drawn : '';" + action + ";"
        "const look = () => { const now = document.querySelector('[data-drawn]');"
        "if (now && now.dataset.drawn !== before) {"
        "requestAnimationFrame(() => requestAnimationFrame(() => done((performance.now() - began) / 1e3))); }"
        "else { setTimeout(look, 1); } }; look();"
    )
    return float(browser.execute_async_script(script))


def in_the_page(server: Server, browser: Any) -> None:
    """To the paint on a server that has seen nothing, and zooms of three linked plots."""
    flight = server.get("flights").json["flights"][0]["id"]
    browser.get(server.address)
    time.sleep(1.0)
    address = f"#/flights?f={flight}&p=made:a&p=made:b&p=made:c"
    began = time.perf_counter()
    browser.get("about:blank")
    browser.get(f"http://127.0.0.1:{server.port}/{address}")
    while not browser.execute_script("return document.querySelector('[data-drawn]')?.dataset.drawn"):
        time.sleep(0.01)
    told("page opened to three plots painted", [time.perf_counter() - began], "0.5 cold, 0.15 warm")
    browser.execute_script("document.querySelector('.chart').focus()")
    press = "document.activeElement.dispatchEvent(new KeyboardEvent('keydown', {key: '%s', bubbles: true}))"
    keys = ["+", "+", "ArrowRight", "-", "ArrowLeft", "+", "-", "-"] * 8
    told(
        "a zoom of three linked plots, to the paint",
        [painted(browser, press % key) for key in keys],
        "p95 0.1",
    )


def drop(data: Path, log: Path, browser: Any) -> None:
    """A log dropped on an empty studio: names, then plots."""
    with studio(data) as server:
        body = log.read_bytes()
        began = time.perf_counter()
        sent = server.send("POST", f"uploads?name={log.name}", body).json
        server.get(f"uploads/{sent['upload']}")
        told(
            f"{len(body) / 1e6:.0f} MB {log.suffix} dropped: names and rates",
            [time.perf_counter() - began],
            "1",
        )
        server.wait(sent["job"]["id"])
        browser.get(server.address)
        while not browser.execute_script("return document.querySelector('[data-drawn]')?.dataset.drawn"):
            time.sleep(0.01)
        told("and plotted", [time.perf_counter() - began], "5")


def together(server: Server, samples: int, people: int) -> None:
    """Zooms of several people at once."""
    flight = server.get("flights").json["flights"][0]["id"]
    end = samples * PERIOD_NS * 1e-9
    seconds: list[float] = []

    def zoom(seed: int) -> None:
        rng = np.random.default_rng(seed)
        for _ in range(20):
            low, high = np.sort(rng.uniform(0, end, 2))
            asked = {
                "f": flight,
                "s": ["made:a", "made:b", "made:c"],
                "w": PIXELS,
                "t0": low,
                "t1": high + 0.1,
            }
            began = time.perf_counter()
            server.get("series", asked)
            seconds.append(time.perf_counter() - began)
            time.sleep(0.2)

    threads = [threading.Thread(target=zoom, args=(seed,)) for seed in range(people)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    told(f"a zoom with {people} people at it, over HTTP", seconds, "p95 0.3")


def main() -> None:
    """Print one line per figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--samples", type=float, default=1e6)
    parser.add_argument("--log", type=Path)
    parser.add_argument("--people", type=int, default=10)
    words = parser.parse_args()
    samples = int(words.samples)
    print(f"load {os.getloadavg()[0]:.1f}", flush=True)
    with tempfile.TemporaryDirectory() as place:
        data = Path(place) / "data"
        make_flight(data, samples)

        def answering() -> None:
            with studio(data) as server:
                starts.append(time.perf_counter() - began)
                assert server.get("about").status == 200

        starts: list[float] = []
        for _ in range(5):
            began = time.perf_counter()
            answering()
        told("start to the first answer", starts, "1.0")
        with studio(data) as server:
            over_http(server, samples)
            together(server, samples, words.people)
        browser = launch(Path(place) / "profile")
        try:
            with studio(data) as server:
                in_the_page(server, browser)
            if words.log:
                drop(Path(place) / "dropped", words.log, browser)
        finally:
            browser.quit()


if __name__ == "__main__":
    main()
