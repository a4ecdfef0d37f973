"""Python functions as simulators: the start is fitted, cheats are found."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import Segment, Signal
from flysid.errors import UsageError
from flysid.outside.bring import bring, brought
from flysid.outside.like import Like

LIKE = Like(0.02, (Signal("pitch", "rad"),), (Signal("v", "m/s"),))
SIMULATORS = """
import numpy as np
from scipy.signal import filtfilt

def drag(u, dt_s, start):
    v = float(start[0])
    out = []
    for (pitch,) in u:
        out.append(v)
        v += dt_s * (9.81 * np.tan(pitch) - 0.3 * v * abs(v))
    return np.array(out)

def lagged(u, dt_s, start):
    v, tilt = start
    out = []
    for (pitch,) in u:
        out.append([v])
        v += dt_s * (9.81 * tilt - 0.5 * v)
        tilt += dt_s * (np.radians(pitch) - tilt) / 0.2
    return out

lagged.start = [0.0, 0.0]
lagged.inputs = {"pitch": "deg"}
lagged.outputs = {"v": "m/s"}

def ahead(u, dt_s, start):
    return filtfilt([0.1], [1.0, -0.9], u[:, 0])

def dice(u, dt_s, start):
    return np.random.normal(size=len(u))

def short(u, dt_s, start):
    return u[1:]

def broken(u, dt_s, start):
    return 1 / 0

def slow(u, dt_s, start):
    return u
slow.dt_s = 0.1

def other(u, dt_s, start):
    return u
other.outputs = ["altitude"]

number = 3
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_simulators.py").write_text(SIMULATORS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "my_simulators", raising=False)


def flight(start: float) -> Segment:
    u = 0.2 * np.sign(np.sin(0.05 * np.arange(600)))[:, None]
    v = start
    y = np.empty((600, 1))
    for k in range(600):
        y[k] = v
        v += 0.02 * (9.81 * np.tan(u[k, 0]) - 0.3 * v * abs(v))
    return Segment(u, y + 0.02 * np.random.default_rng(1).normal(size=y.shape), 0, "a")


def test_a_free_run_starts_where_the_window_says() -> None:
    model = bring("my_simulators:drag", LIKE)
    segment = flight(2.0)
    run = model.free_run(segment)  # type: ignore[attr-defined]
    assert np.sqrt(np.mean((run - segment.y) ** 2)) == pytest.approx(0.02, rel=0.1)
    ahead = model.predict(segment.u, segment.y, 3)
    assert np.isnan(ahead[: model.n_init + 2]).all()
    assert np.isfinite(ahead[model.n_init + 2 :]).all()
    y0 = segment.y[: model.n_init]
    assert np.array_equal(model.simulate(segment.u, y0)[: model.n_init], y0)


def test_a_start_of_its_own_and_other_units() -> None:
    model = bring("my_simulators:lagged", LIKE)
    u = 0.2 * np.sign(np.sin(0.05 * np.arange(600)))[:, None]
    y = model.simulator.run(np.degrees(u), np.array([1.5, -0.3]))  # type: ignore[attr-defined]
    run = model.free_run(Segment(u, y, 0, "a"))  # type: ignore[attr-defined]
    assert np.abs(run - y).max() < 1e-6
    assert any("converted" in note for note in model.notes)


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("ahead", "inputs that are still to come"),
        ("dice", "another answer the second time"),
        ("short", r"returns shape \(59, 1\), not \(60, 1\)"),
        ("broken", "fails: ZeroDivisionError"),
        ("slow", "sample time 0.1 s, the data 0.02 s"),
        ("other", "outputs are altitude, the data's v"),
        ("number", "not a function"),
        ("gone", "cannot be imported: AttributeError"),
    ],
)
def test_what_is_no_simulator_is_refused(name: str, match: str) -> None:
    with pytest.raises(UsageError, match=match):
        bring(f"my_simulators:{name}", LIKE)
    with pytest.raises(UsageError, match="cannot be imported"):
        bring("no_such_module:f", LIKE)


def test_a_start_that_nothing_takes_is_refused() -> None:
    channels = {"x": {"own": bring("my_simulators:drag", LIKE)}}
    source = ["mine=my_simulators:drag"]
    assert brought(source, channels)["x"].keys() == {"mine"}
    for start in ("other=v", "mine", "mine="):
        with pytest.raises(UsageError, match="is not the start of any model"):
            brought(source, channels, [start])
    with pytest.raises(UsageError, match="is not an FMU"):
        brought(source, channels, ["mine=v"])
