"""One studio for the tests that only read, over two flights that flysid has synthesised."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from tests.flysid.studio.server import SAMPLES, Server, studio

pytest.importorskip("starlette", reason='the studio is not installed: pip install "flysid[studio]"')
pytest.importorskip("uvicorn", reason='the studio is not installed: pip install "flysid[studio]"')


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("studio") / "data"
    logs = [SAMPLES / "01-multisine-seed1.tlog", SAMPLES / "01-steps-seed4.mcap"]
    assert not [r.reason for r in ingest_logs(find_logs(logs), folder, bounds=None) if r.skipped]
    return folder


@pytest.fixture(scope="session")
def server(data: Path) -> Iterator[Server]:
    with studio(data) as running:
        yield running
