"""An ingest from a store that is far away, refuses, or throttles; and a client that is told of 100,000 logs.

    python -m bench.fleet_weather [--logs N] [--many N]

A proxy on loopback stands before the S3 server. It waits before each answer, refuses a share of requests
with 503, and those above a rate. Logs of the second part are there in lists only: the proxy makes those up,
and nobody reads them; what a batch would have brought is made up, too.
"""

from __future__ import annotations

import argparse
import http.client
import os
import random
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs, urlsplit

import msgspec

from bench.fleet import fill, resident_bytes, server, synthesised
from flysid.catalogue import FlightFacts
from flysid.fleet.ingest_many import Threads, find, ingest
from flysid.fleet.lakes import create_lake
from flysid.fleet.reading import LogAddress, LogOutcome, Settings
from flysid.fleet.upkeep import check
from flysid.place import Place

SLOW_DOWN = b"<Error><Code>SlowDown</Code><Message>Reduce your request rate.</Message></Error>"
PAGE = 1000
FLEET = "made-up/"


@dataclass
class Weather:
    """How a store behaves, and what was asked of it.

    Attributes
    ----------
    latency_s : before each answer.
    refused : share of requests that are answered with 503.
    rate : requests a second; those above it are answered with 503. 0 is without a bound.
    many : how many logs there are in lists of `made-up/`.
    """

    latency_s: float = 0.0
    refused: float = 0.0
    rate: float = 0.0
    many: int = 0
    asked: Counter[str] = field(default_factory=Counter)
    at_once: int = 0
    most: int = 0
    allowed: float = 0.0
    last: float = field(default_factory=time.monotonic)
    lock: threading.Lock = field(default_factory=threading.Lock)
    chance: random.Random = field(default_factory=lambda: random.Random(1))

    def refuses(self, method: str) -> bool:
        """Whether the next request is refused; counts it."""
        with self.lock:
            now = time.monotonic()
            self.allowed = min(self.rate, self.allowed + (now - self.last) * self.rate)
            self.last = now
            is_over = self.rate > 0 and self.allowed < 1
            self.allowed -= not is_over
            no = is_over or self.chance.random() < self.refused
            self.asked["503" if no else method] += 1
            return no


class Handler(BaseHTTPRequestHandler):
    """Passes requests on as they are: their signature covers the address that the client used."""

    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True
    weather: Weather
    behind: int

    def do_any(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        weather = self.weather
        with weather.lock:
            weather.at_once += 1
            weather.most = max(weather.most, weather.at_once)
        try:
            refused = weather.refuses(self.command)
            time.sleep(weather.latency_s)
            if refused:
                self.answer(503, {}, SLOW_DOWN)
            elif page := self.made_up():
                self.answer(200, {"Content-Type": "application/xml"}, page)
            else:
                self.pass_on(body)
        finally:
            with weather.lock:
                weather.at_once -= 1

    do_GET = do_PUT = do_HEAD = do_POST = do_DELETE = do_any

    def pass_on(self, body: bytes) -> None:
        """Ask the server behind, and answer as it does."""
        there = http.client.HTTPConnection("127.0.0.1", self.behind, timeout=120)
        there.request(self.command, self.path, body, dict(self.headers))
        answer = there.getresponse()
        content = answer.read()
        kept = {name: value for name, value in answer.getheaders() if name.lower() != "transfer-encoding"}
        self.answer(answer.status, kept, content)
        there.close()

    def answer(self, status: int, headers: dict[str, str], content: bytes) -> None:
        self.send_response_only(status)
        if self.command != "HEAD":
            headers = {n: v for n, v in headers.items() if n.lower() != "content-length"}
            headers["Content-Length"] = str(len(content))
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content if self.command != "HEAD" else b"")

    def made_up(self) -> bytes:
        """A page of the list of logs that are not there; nothing for other requests."""
        asked = parse_qs(urlsplit(self.path).query)
        if self.command != "GET" or asked.get("prefix", [""])[0] != FLEET:
            return b""
        first = int(asked.get("continuation-token", ["0"])[0])
        last = min(first + PAGE, self.weather.many)
        items = "".join(
            f"<Contents><Key>{FLEET}v{n % 1000:03d}/{n}.bin</Key><LastModified>2026-10-01T00:00:00.000Z"
            f'</LastModified><ETag>"{n:032x}"</ETag><Size>{10_000_000 + n}</Size></Contents>'
            for n in range(first, last)
        )
        more = f"<NextContinuationToken>{last}</NextContinuationToken>" if last < self.weather.many else ""
        head = f"<ListBucketResult><IsTruncated>{str(bool(more)).lower()}</IsTruncated>"
        return f"{head}{items}{more}</ListBucketResult>".encode()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


class Proxy(ThreadingHTTPServer):
    """Many requests at once."""

    daemon_threads = True
    request_queue_size = 128


@contextmanager
def behind(weather: Weather, port: int) -> Iterator[None]:
    """The store as it is in a weather, for this process's clients."""
    handler = type("Weathered", (Handler,), {"weather": weather, "behind": port})
    proxy = Proxy(("127.0.0.1", 0), handler)
    threading.Thread(target=proxy.serve_forever, daemon=True).start()
    direct = os.environ["AWS_ENDPOINT_URL"]
    os.environ["AWS_ENDPOINT_URL"] = f"http://127.0.0.1:{proxy.server_port}"
    try:
        yield
    finally:
        os.environ["AWS_ENDPOINT_URL"] = direct
        proxy.shutdown()
        proxy.server_close()


WEATHERS = {
    "fair": Weather(),
    "30 ms away": Weather(latency_s=0.03),
    "5 % refused": Weather(refused=0.05),
    "20 % refused": Weather(refused=0.2),
    "10 requests a second": Weather(rate=10.0),
}


def ingests(port: int, count: int) -> None:
    """The same logs into a lake in each weather."""
    fill(Place("s3://inbox"), count)
    for name, weather in WEATHERS.items():
        lake = f"s3://lakes/{name.replace(' ', '-').replace('%', 'percent')}"
        Place("s3://lakes").put("first", b"")
        runs = 0
        waited: list[int] = []
        began = time.monotonic()
        with behind(weather, port):
            create_lake(lake)
            while (found := find(["s3://inbox"], lake)).waiting:
                settings = Settings(lake, bounds=None, vehicle_in=r"v\d+")
                outcomes = list(ingest(found, settings, Threads(2)))
                waited.append(sum(outcome.status == "waiting" for outcome in outcomes))
                runs += 1
        wall = time.monotonic() - began
        state = check(Place(lake))
        asked = sum(weather.asked.values())
        print(
            f"{name}: {len(state.flights)} of {count} flights, whole: {state.is_whole}, after {runs} runs "
            f"({waited} logs left waiting); {wall / count:.2f} s of wall time a log, {asked / count:.1f} "
            f"requests a log ({dict(weather.asked)}), {weather.most} at once at most",
            flush=True,
        )


@dataclass(frozen=True)
class MadeUp:
    """An engine that brings what logs of lists would be: no log is read, all else is done."""

    workers: int = 2

    def run(
        self, batches: Sequence[tuple[LogAddress, ...]], settings: Settings
    ) -> Iterator[tuple[tuple[LogAddress, ...], list[LogOutcome]]]:
        """See `flysid.fleet.ingest_many.Engine`."""
        assert settings
        for part in batches:
            yield part, [LogOutcome(log, "ingested", made_up_flight(log)) for log in part]


def made_up_flight(log: LogAddress) -> FlightFacts:
    """What the catalogue holds of a log of the lists."""
    facts = synthesised(int(log.name.partition(".")[0]))
    info = dict(facts.info) | {"source_url": log.url, "source_etag": log.etag}
    return msgspec.structs.replace(facts, info=info)


def client(port: int, many: int) -> None:
    """What a client does for many logs: it lists, sorts out, makes batches, and writes the catalogue."""
    lake = "s3://inbox/made-up-lake"
    create_lake(lake)
    weather = Weather(latency_s=0.03, refused=0.05, many=many)
    with behind(weather, port):
        for name in ("none is known", "all are known"):
            weather.asked.clear()
            before = resident_bytes()
            cpu, wall = time.process_time(), time.monotonic()
            found = find([f"s3://inbox/{FLEET}"], lake)
            print(
                f"{many} logs, 30 ms away, 5 % refused; {name}: {len(found.waiting)} waiting, found in "
                f"{time.process_time() - cpu:.1f} s of CPU (the proxy's with it), "
                f"{time.monotonic() - wall:.0f} s; {sum(weather.asked.values())} requests, "
                f"{weather.asked['503']} refused; {(resident_bytes() - before) / 1e6:.0f} MB grown",
                flush=True,
            )
            if found.waiting:
                weather.asked.clear()
                cpu, wall = time.process_time(), time.monotonic()
                done = sum(1 for _ in ingest(found, Settings(lake), MadeUp()))
                print(
                    f"  {done} outcomes entered in {time.process_time() - cpu:.1f} s of CPU, "
                    f"{time.monotonic() - wall:.0f} s; {sum(weather.asked.values())} requests",
                    flush=True,
                )


def main() -> None:
    """Run both parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--logs", type=int, default=100)
    parser.add_argument("--many", type=int, default=100_000)
    options = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f}")
    with server() as s3:
        Place("s3://inbox").put("first", b"")
        Place("s3://inbox").delete(["first"])
        client(s3.port, options.many)
        ingests(s3.port, options.logs)


if __name__ == "__main__":
    main()
