"""What the studio takes: to answer, to the paint, a zoom, a dropped log, ten people at once.

    python -m bench.studio [--samples 1e6] [--log FILE...] [--people 10]

Wall times, best, median and 95th percentile: an idle machine is asked for; its load is printed, and the CPU
time of the server (best), which a busy machine changes little. Chromium and chromedriver draw. The fields are
made here; --log is dropped on the page.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import statistics
import struct
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from flysid.flight import BOOT, TIME, ClockMap, Damage, Source
from flysid.ingest.lake.workers import anonymous_bytes
from flysid.store import create_data_folder, write_flight
from tests.browser import ONE_PROCESS, launch
from tests.flysid.studio.server import Server, studio

PIXELS = 1200
ROWS = 1 << 20
PERIOD_NS = 1_000_000
SPIKE = 1e7
FRESH = 5  # servers that have seen nothing
ENDED = ("done", "failed", "cancelled", "interrupted")
BROWSERS = {
    "a browser that has a process for the studio's pages": (),
    "a browser that begins one for every page": ONE_PROCESS,
}
MOST_FRESH = 10**7  # samples that are read anew for each of them


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
            columns["a"][rows == samples // 2] = SPIKE
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


def cpu_s(server: Server) -> float:
    """CPU time that the server has taken."""
    return ticks(server.process.pid) / os.sysconf("SC_CLK_TCK")


def told(name: str, seconds: Sequence[float], goal: str, cpu: Sequence[float] = ()) -> None:
    """One line: best, median, 95th percentile; the least CPU time of the server."""
    high = float(np.percentile(seconds, 95))
    middle = statistics.median(seconds)
    print(
        f"{name:58} best {min(seconds):.3f}  median {middle:.3f}  p95 {high:.3f} s  (goal {goal})"
        + (f"  server's CPU {min(cpu):.2f} s" if cpu else ""),
        flush=True,
    )


def resident_mb(server: Server) -> str:
    """Memory of the server, and what of it no file backs."""
    pages = int(Path(f"/proc/{server.process.pid}/statm").read_text("utf-8").split()[1])
    own = anonymous_bytes(server.process.pid) / 1e6
    return f"{pages * os.sysconf('SC_PAGESIZE') / 1e6:.0f} MB, {own:.0f} MB without mapped files"


def over_http(server: Server, samples: int) -> None:
    """Three fields, cold and warm, and windows of any size."""
    flight = server.get("flights").json["flights"][0]["id"]
    asked: dict[str, Any] = {"f": flight, "s": ["made:a", "made:b", "made:c"], "w": PIXELS}
    before = cpu_s(server)
    cold = timed(lambda: server.get("series", asked))
    told(f"3 x {samples:.0e} over HTTP, cold", [cold], "", [cpu_s(server) - before])
    before = cpu_s(server)
    warm = [timed(lambda: server.get("series", asked)) for _ in range(20)]
    told("the same, warm", warm, "", [(cpu_s(server) - before) / len(warm)])
    end = samples * PERIOD_NS * 1e-9
    rng = np.random.default_rng(2)
    sizes = []
    seconds = []
    seen = []
    for _ in range(100):
        low, high = np.sort(rng.uniform(0, end, 2))
        began = time.perf_counter()
        body = server.get("series", asked | {"t0": low, "t1": high + 0.01}).body
        seconds.append(time.perf_counter() - began)
        sizes.append(len(body))
        if low <= samples // 2 * PERIOD_NS * 1e-9 <= high:
            seen.append(highest(body) > SPIKE / 2)
    told("100 windows of any size over HTTP", seconds, "")
    print(f"the spike of one sample is seen in {sum(seen)} of the {len(seen)} windows that hold it")
    print(f"largest answer {max(sizes) / 1e3:.0f} kB (goal 100); server {resident_mb(server)}", flush=True)


def highest(body: bytes) -> float:
    """The highest value of the first series of an answer."""
    length = struct.unpack_from("<I", body)[0]
    one = json.loads(body[4 : 4 + length])["series"][0]
    values = np.frombuffer(body, "<f4", one["points"], 4 + length + 4 * one["points"])
    return float(np.nanmax(values)) + float(one["base"])


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


def opened(server: Server, browser: Any) -> tuple[float, float]:
    """The page with three plots: seconds to the paint, and CPU time of the server."""
    flight = server.get("flights").json["flights"][0]["id"]
    browser.get("about:blank")
    before = cpu_s(server)
    began = time.perf_counter()
    browser.get(f"http://127.0.0.1:{server.port}/#/flights?f={flight}&p=made:a&p=made:b&p=made:c")
    while not browser.execute_script("return document.querySelector('[data-drawn]')?.dataset.drawn"):
        time.sleep(0.005)
    return time.perf_counter() - began, cpu_s(server) - before


def fresh(data: Path, browser: Any) -> tuple[float, float]:
    """The same of a server that has read nothing; its imports are behind it."""
    with studio(data) as server:
        browser.get(server.address)
        server.get("runs/none/worst")  # waits for the last room
        time.sleep(1.0)
        return opened(server, browser)


def in_the_page(server: Server, browser: Any) -> None:
    """To the paint where all is mapped, zooms of three linked plots, and the last of 100 random ones."""
    browser.get(server.address)
    opened(server, browser)
    seconds, cpu = zip(*[opened(server, browser) for _ in range(FRESH)], strict=True)
    told("page opened to three plots painted, warm", seconds, "0.15", cpu)
    told(
        "an empty page of the same server, for comparison", [empty(server, browser) for _ in range(FRESH)], ""
    )
    tell_the_page_s_work(server, browser)
    browser.execute_script("document.querySelector('.chart').focus()")
    press = "document.activeElement.dispatchEvent(new KeyboardEvent('keydown', {key: '%s', bubbles: true}))"
    keys = ["+", "+", "ArrowRight", "-", "ArrowLeft", "+", "-", "-"] * 8
    told(
        "a zoom of three linked plots, to the paint",
        [painted(browser, press % key) for key in keys],
        "p95 0.1",
    )
    for key in random.Random(3).choices(["+", "-", "ArrowLeft", "ArrowRight"], k=100):
        browser.execute_script(press % key)
    time.sleep(1.0)
    drawn = browser.execute_script("return document.querySelector('[data-drawn]').dataset.drawn")
    asked = browser.execute_script("return new URLSearchParams(location.hash.split('?')[1]).get('t')")
    print(f"after 100 random zooms {drawn} is drawn, {asked or 'all'} is asked for", flush=True)


def empty(server: Server, browser: Any) -> float:
    """Seconds to open a page with nothing on it: the browser's own part, and the driver's."""
    browser.get("about:blank")
    began = time.perf_counter()
    browser.get(f"http://127.0.0.1:{server.port}/icon.svg")
    browser.execute_script("return document.readyState")
    return time.perf_counter() - began


def tell_the_page_s_work(server: Server, browser: Any) -> None:
    """CPU of the page's main thread from the navigation to the paint, medians of some openings."""
    browser.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
    names = ("TaskDuration", "ScriptDuration", "LayoutDuration", "RecalcStyleDuration")
    spent: dict[str, list[float]] = {name: [] for name in names}
    series = []
    for _ in range(FRESH):
        opened(server, browser)
        metrics = browser.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
        for one in metrics:
            if one["name"] in spent:
                spent[one["name"]].append(1e3 * one["value"])
        asked = (
            "return performance.getEntriesByType('resource').filter(x => x.name.includes('/series?')).length"
        )
        series.append(browser.execute_script(asked))
    cells = [
        f"{name.removesuffix('Duration').lower()} {statistics.median(spent[name]):.0f}" for name in names
    ]
    print(f"the page's main thread, ms of CPU: {', '.join(cells)}; curves asked for {max(series)} time(s)")


def drop(data: Path, log: Path, browser: Any) -> None:
    """A log dropped on an empty studio: names, then plots."""
    with studio(data) as server:
        server.get("runs/none/worst")  # waits for the last room
        time.sleep(2.0)
        body = log.read_bytes()
        before = work_of(server)
        began = time.perf_counter()
        sent = server.send("POST", f"uploads?name={log.name}", body).json
        server.get(f"uploads/{sent['upload']}")
        told(
            f"{len(body) / 1e6:.0f} MB {log.suffix} dropped: names and rates",
            [time.perf_counter() - began],
            "1",
        )
        after = dict(before)
        while server.get(f"jobs/{sent['job']['id']}").json["state"] not in ENDED:
            after |= work_of(server)  # what has ended is not there any more
            time.sleep(0.02)
        browser.get(server.address)
        while not browser.execute_script("return document.querySelector('[data-drawn]')?.dataset.drawn"):
            time.sleep(0.01)
        told("and plotted", [time.perf_counter() - began], "5")
        after |= work_of(server)
        cpu, waited = (
            {pid: work[k] - before.get(pid, (0.0, 0.0))[k] for pid, work in after.items()} for k in (0, 1)
        )
        busiest = max(cpu, key=lambda pid: cpu[pid])
        print(
            f"CPU of the server and its jobs {sum(cpu.values()):.2f} s; the reader {cpu[busiest]:.2f} s,"
            f" and {waited[busiest]:.2f} s in which it waited for a core",
            flush=True,
        )


def work_of(server: Server) -> dict[int, tuple[float, float]]:
    """The server and all that it has begun: CPU time, and time spent waiting for a core, s (Linux)."""
    parents: dict[int, int] = {}
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            fields = (path / "stat").read_text("utf-8").rpartition(")")[2].split()
            parents[int(path.name)] = int(fields[1])
    own = {server.process.pid}
    while more := {pid for pid, parent in parents.items() if parent in own} - own:
        own |= more
    found = {}
    for pid in own:
        with suppress(OSError):
            cpu = ticks(pid) / os.sysconf("SC_CLK_TCK")
            waited = Path(f"/proc/{pid}/schedstat").read_text("utf-8").split()[1]  # of its first thread
            found[pid] = (cpu, int(waited) * 1e-9)
    return found


def ticks(pid: int) -> int:
    """CPU time of a process in the system's ticks, of threads that have ended, too."""
    fields = Path(f"/proc/{pid}/stat").read_text("utf-8").rpartition(")")[2].split()
    return int(fields[11]) + int(fields[12])


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
    parser.add_argument("--log", type=Path, action="append", default=[])
    parser.add_argument("--people", type=int, default=10)
    parser.add_argument("--only", choices=["drop", "page"], help="logs that are dropped, or the page, alone")
    words = parser.parse_args()
    samples = int(words.samples)
    print(f"load {os.getloadavg()[0]:.1f}", flush=True)
    with tempfile.TemporaryDirectory() as place:
        data = Path(place) / "data"
        make_flight(data, samples)

        if not words.only:
            at_the_server(data, samples, words.people)
        if words.only != "drop":
            for title, without in BROWSERS.items():
                print(title)
                with browsing(Path(place) / title, without) as browser:
                    at_the_page(data, samples, browser)
        if words.only != "page":
            with browsing(Path(place) / "profile") as browser:
                for number, log in enumerate(words.log):
                    drop(Path(place) / f"dropped-{number}", log, browser)


@contextmanager
def browsing(profile: Path, without: tuple[str, ...] = ()) -> Iterator[Any]:
    """Chromium without some of the tests' flags."""
    browser = launch(profile, without)
    try:
        yield browser
    finally:
        browser.quit()


def at_the_server(data: Path, samples: int, people: int) -> None:
    """Starts, and what is asked for over HTTP."""

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
        together(server, samples, people)


def at_the_page(data: Path, samples: int, browser: Any) -> None:
    """Paints of servers that have read nothing, and of one that has."""
    if samples <= MOST_FRESH:
        seconds, cpu = zip(*[fresh(data, browser) for _ in range(FRESH)], strict=True)
        told("page opened to three plots painted, nothing read yet", seconds, "0.5", cpu)
    with studio(data) as server:
        in_the_page(server, browser)


if __name__ == "__main__":
    main()
