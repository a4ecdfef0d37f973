"""One run to watch with, for the tests of logs, links and the page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from flysid.ingest.synth.synth import Order, fly_one
from flysid.ingest.synth.telemetry import Telemetry
from flysid.ingest.synth.writers.mavlink import tlog_bytes
from tests.command import call, call_quick
from tests.flysid.live.flown import FAULT_S


@pytest.fixture(scope="session")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run on simulated flights, a nominal log, and one whose forward speed is off from 40 s on."""
    folder = tmp_path_factory.mktemp("watch")
    order = Order(plan="mixed", duration_s=120.0, seed=5)
    (folder / "logs").mkdir()
    for k in range(4):
        recording = fly_one(order, k)
        (folder / "logs" / f"{k}.tlog").write_bytes(tlog_bytes(recording))
    done = call("ingest", "logs", "-o", "data", "-j", "1", "-q", cwd=folder)
    assert done.returncode == 0, done.stderr
    fit = ("fit", "data", "-r", "ardrone-synthetic", "-o", "run", "-q", "--holdout", "0.5")
    done = call_quick(*fit, "--channel", "longitudinal", "-j", "1", cwd=folder)
    assert done.returncode == 0, done.stderr
    recording = fly_one(replace(order, seed=6, duration_s=80.0), 0)
    (folder / "good.tlog").write_bytes(tlog_bytes(recording))
    late = recording.state.time_ns >= recording.state.time_ns[0] + FAULT_S * 1e9
    values = {**recording.state.values, "vx": recording.state["vx"] + 0.4 * late}
    broken = replace(recording, state=Telemetry(recording.state.time_ns, values))
    (folder / "bad.tlog").write_bytes(tlog_bytes(broken))
    return folder
