"""One studio for the tests that only read, over two flights that flysid has synthesised."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from tests.flysid.studio.server import FIT, SAMPLES, Server, studio

pytest.importorskip("starlette", reason='the studio is not installed: pip install "flysid[studio]"')
pytest.importorskip("uvicorn", reason='the studio is not installed: pip install "flysid[studio]"')


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("studio") / "data"
    logs = [SAMPLES / "01-multisine-seed1.tlog", SAMPLES / "01-steps-seed4.mcap"]
    assert not [r.reason for r in ingest_logs(find_logs(logs), folder, bounds=None) if r.skipped]
    return folder


@pytest.fixture(scope="session")
def judged(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A studio with one run of the vertical channel, fitted and judged as the page does it."""
    own = Path(shutil.copytree(data, tmp_path_factory.mktemp("judged") / "data"))
    with studio(own, module="tests.arx_flysid") as running:
        job = running.send("POST", "fits", FIT).json
        ended = running.wait(job["id"], 400)
        assert ended["state"] == "done", running.get(f"jobs/{job['id']}").body
        [judging] = [j for j in running.get("jobs").json["jobs"] if j["words"][0] == "validate"]
        assert running.wait(judging["id"])["state"] == "done"
        yield running


@pytest.fixture(scope="session")
def server(data: Path) -> Iterator[Server]:
    with studio(data) as running:
        yield running
