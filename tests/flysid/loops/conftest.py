"""A log that Betaflight's own firmware wrote, flown once and kept outside the repository."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from bench.sitl import NoFirmware, fly

KEPT = Path(tempfile.gettempdir()) / "flysid-sitl"


@pytest.fixture(scope="session")
def firmware_log() -> Path:
    """40 s under the firmware's own gains."""
    known = sorted((KEPT / "default").glob("LOG*.BF"))
    if known:
        return known[-1]
    try:
        return fly(KEPT / "default", 40.0, 7)
    except NoFirmware as error:
        pytest.skip(str(error))
