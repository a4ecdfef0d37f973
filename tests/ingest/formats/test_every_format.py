"""One simulated flight, logged in every format, gives back what was flown."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

import flysid
from flysid.cli import root
from flysid.dataset import Dataset
from flysid.ingest.align.align import dataset

FORMATS = ("tlog", "mcap", "dataflash", "ulog", "navdata", "pcap", "mcap-ros1", "mcap-ros2")
# suffix of the log -> recipe and, for (tilt forwards, velocity forwards), channel and sign of its input
CHANNELS = {
    ".tlog": ("ardrone-synthetic", "longitudinal", 1.0),
    "seed1.mcap": ("ardrone-synthetic", "longitudinal", 1.0),
    ".bin": ("ardupilot-velocity", "v_x", -1.0),
    ".ulg": ("px4-velocity", "v_x", -1.0),
    ".navdata": ("ardrone-inner", "longitudinal", 1.0),
    ".pcap": ("ardrone-inner", "longitudinal", 1.0),
    ".ros1.mcap": ("ardrone-inner", "longitudinal", 1.0),
    ".ros2.mcap": ("ardrone-inner", "longitudinal", 1.0),
}
SHORT = 100


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """20 s of the linear AR.Drone with a drop-out of one second, without measurement noise, and the truth."""
    out = tmp_path_factory.mktemp("logs")
    chosen = [a for name in FORMATS for a in ("--format", name)]
    flown = ["synth", "-o", str(out), "--truth", "--plan", "multisine", "--duration", "20", "--noise", "0"]
    done = CliRunner().invoke(root, [*flown, "--dropout", "10:1.0", "-q", *chosen], catch_exceptions=False)
    assert done.exit_code == 0
    return out


def against_truth(values: np.ndarray, truth: np.ndarray) -> tuple[int, float]:
    """Where in the truth the values begin, and their RMS error as a share of the truth's amplitude."""
    windows = np.lib.stride_tricks.sliding_window_view(truth, SHORT)
    at = int(np.argmin(((windows - values[:SHORT]) ** 2).sum(axis=1)))
    length = min(len(values), len(truth) - at)
    error = values[:length] - truth[at : at + length]
    return at, float(np.sqrt(np.mean(error**2)) / np.abs(truth).max())


# the other axis: its channel, its columns of the truth; rolling right drives right in every format
SIDEWAYS = {"longitudinal": "lateral", "v_x": "v_y"}


@pytest.mark.parametrize("suffix", CHANNELS)
@pytest.mark.parametrize("axis", ["forwards", "sideways"])
def test_inputs_and_outputs_come_back(logs: Path, suffix: str, axis: str) -> None:
    (path,) = [p for p in logs.iterdir() if p.name.endswith(suffix)]
    (truth_file,) = logs.glob("*.truth.parquet")
    truth = pq.read_table(truth_file)
    recipe, channel, sign = CHANNELS[suffix]
    columns = ("theta_in", "vx")
    if axis == "sideways":
        channel = SIDEWAYS[channel]
        sign = 1.0
        columns = ("phi_in", "vy")
    data: Dataset = dataset([flysid.read(path)], recipe, channel)
    assert data.dt_s == pytest.approx(0.02)
    assert len(data.segments) == 2  # nothing across the drop-out
    ros = ".ros" in suffix  # a Twist has no stamp: its log time is off by the link's delay
    for segment in data.segments:
        at_u, error_u = against_truth(sign * segment.u[:, 0], truth[columns[0]].to_numpy())
        at_y, error_y = against_truth(segment.y[:, 0], truth[columns[1]].to_numpy())
        assert error_y < 0.01
        assert error_u < (0.08 if ros else 0.002)
        assert abs(at_u - at_y) <= (3 if ros else 0)  # a link just back from a drop-out is late
