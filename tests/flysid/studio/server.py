"""A real studio in a process of its own, and requests to it as a browser or an attacker sends them."""

from __future__ import annotations

import http.client
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

FIT = {
    "recipe": "ardrone-synthetic",
    "channels": ["vertical"],
    "models": "line,ts",
    "rules": "2",
    "effort": "quick",
    "name": "mine",
}
ROOT = Path(__file__).resolve().parents[3]
SAMPLES = ROOT / "sample_logs"


@dataclass(frozen=True)
class Answer:
    """What came back."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass
class Server:
    """A studio that runs: its folder, its address with the token, its process."""

    data: Path
    address: str
    process: subprocess.Popen[str]
    cookie: str = field(init=False, default="")

    def __post_init__(self) -> None:
        answer = self.raw("GET", "/?token=" + self.token)
        self.cookie = answer.headers["set-cookie"].partition(";")[0]

    @property
    def port(self) -> int:
        return int(self.address.split(":")[2].split("/")[0])

    @property
    def token(self) -> str:
        return self.address.rpartition("=")[2].partition("#")[0]

    def raw(
        self, method: str, path: str, body: bytes | None = None, headers: Mapping[str, str] | None = None
    ) -> Answer:
        """One request with exactly these headers (and Host, unless given)."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=600)
        try:
            connection.request(method, path, body, dict(headers or {}))
            answer = connection.getresponse()
            told = {name.lower(): value for name, value in answer.getheaders()}
            return Answer(answer.status, told, answer.read())
        finally:
            connection.close()

    def get(self, path: str, query: Any = None) -> Answer:
        words = "?" + urlencode(query, doseq=True) if query else ""
        return self.raw("GET", "/api/1/" + path + words, headers={"Cookie": self.cookie})

    def send(self, method: str, path: str, body: object = None) -> Answer:
        raw = body if isinstance(body, bytes) else json.dumps(body).encode()
        headers = {"Cookie": self.cookie, "Content-Type": "application/json"}
        return self.raw(method, "/api/1/" + path, raw, headers)

    def wait(self, job: str, seconds: float = 120.0) -> Any:
        """The job when it has ended."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            told = self.get(f"jobs/{job}").json
            if told["state"] in ("done", "failed", "cancelled", "interrupted"):
                return told
            time.sleep(0.05)
        raise AssertionError(f"job {job} has not ended: {told}")


@contextmanager
def studio(data: Path, *more: str, module: str = "flysid", site: Path = ROOT) -> Iterator[Server]:
    """Start `flysid studio` on a free port, beside the packages in `site`; end it as Ctrl-C does."""
    state = data.absolute().parent.with_suffix(".state")
    process = subprocess.Popen(
        [sys.executable, "-m", module, "studio", str(data), "--no-open", *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": f"{site}{os.pathsep}{ROOT}", "XDG_STATE_HOME": str(state)},
    )
    try:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        if not address:
            raise AssertionError(process.communicate()[1])
        until = time.monotonic() + 60
        while True:
            try:
                yield Server(data, address, process)
                break
            except ConnectionRefusedError:
                if time.monotonic() > until:
                    raise
                time.sleep(0.05)
    finally:
        process.terminate()
        process.communicate(timeout=60)
