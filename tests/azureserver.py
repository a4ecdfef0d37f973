"""A real server of Azure blobs on loopback: Azurite, which npm brings."""

from __future__ import annotations

import base64
import hashlib
import hmac
import shutil
import sys
import urllib.error
import urllib.request
from email.utils import formatdate
from pathlib import Path

from tests.s3server import S3Server, free_port

CONTAINER = "tests"
ACCOUNT = "devstoreaccount1"
KEY = base64.b64encode(b"s3cret-of-azure-never-seen").decode()


class AzureServer(S3Server):
    """It speaks Azure's own protocol, and has one container."""

    @property
    def environment(self) -> dict[str, str]:
        """What a client needs: the provider's own variables."""
        return {
            "AZURE_STORAGE_ACCOUNT_NAME": ACCOUNT,
            "AZURE_STORAGE_ACCOUNT_KEY": KEY,
            "AZURE_STORAGE_USE_EMULATOR": "true",  # else its lists are asked for what Azurite does not know
            "AZURITE_BLOB_STORAGE_URL": self.endpoint,
            "AZURE_MSI_ENDPOINT": "http://127.0.0.1:1/metadata/identity/oauth2/token",
        }

    def start(self, timeout_s: float = 60.0) -> None:
        """Start it, wait until it answers, and make the container; no client of flysid's makes one."""
        super().start(timeout_s)
        headers = {"x-ms-date": formatdate(usegmt=True), "x-ms-version": "2021-12-02"}
        named = "".join(f"{name}:{value}\n" for name, value in headers.items())
        resource = f"/{ACCOUNT}/{ACCOUNT}/{CONTAINER}\nrestype:container"
        signed = "PUT" + "\n" * 12 + named + resource
        digest = hmac.digest(base64.b64decode(KEY), signed.encode(), hashlib.sha256)
        headers["Authorization"] = f"SharedKey {ACCOUNT}:{base64.b64encode(digest).decode()}"
        address = f"{self.endpoint}/{ACCOUNT}/{CONTAINER}?restype=container"
        asked = urllib.request.Request(address, method="PUT", headers=headers)
        try:
            urllib.request.urlopen(asked, timeout=30).close()
        except urllib.error.HTTPError as error:
            if error.code != 409:  # it is there since it was started before
                raise


def azurite(folder: Path) -> AzureServer | None:
    """A server that keeps its objects in `folder`; None where Azurite is not installed."""
    beside = Path(sys.prefix) / "node_modules" / ".bin" / "azurite-blob"
    program = str(beside) if beside.exists() else shutil.which("azurite-blob")
    if program is None or shutil.which("node") is None:
        return None
    port = free_port()
    # fmt: off
    command = [
        "env", f"AZURITE_ACCOUNTS={ACCOUNT}:{KEY}",
        program, "--silent", "--location", str(folder), "--blobHost", "127.0.0.1", "--blobPort", str(port),
        "--skipApiVersionCheck", "--disableTelemetry",
    ]
    # fmt: on
    return AzureServer(command, port, folder / "server.log")
