"""A log that Betaflight's own firmware wrote, flown once and kept outside the repository."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from bench.sitl import NoFirmware, fly

FLOWN = Path(tempfile.gettempdir()) / "flysid-sitl" / "stalled"


@pytest.fixture(scope="session")
def firmware_log() -> Path:
    """40 s under the firmware's own gains, on a processor that is late at times."""
    known = sorted(FLOWN.glob("LOG*.BF"))
    if known:
        return known[-1]
    try:
        return fly(FLOWN, 40.0, 7, stall_s=0.03)
    except NoFirmware as error:
        pytest.skip(str(error))
