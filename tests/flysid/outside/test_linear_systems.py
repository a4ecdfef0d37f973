"""Stored linear systems against scipy's own arithmetic."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal
from scipy.io import savemat

from flysid.dataset import Segment, Signal
from flysid.errors import FlysidError
from flysid.model.base import load
from flysid.outside.bring import bring
from flysid.outside.like import Like

DT = 0.02
ONE = Like(DT, (Signal("theta_in", "rad"),), (Signal("v_x", "m/s"),))
TWO = Like(DT, (Signal("a"), Signal("b")), (Signal("p"), Signal("q")))
U = np.random.default_rng(3).normal(size=(300, 1))
B = [0.0, 0.02, 0.01]
F = [1.0, -1.7, 0.72]


def text(path: Path, words: str) -> str:
    path.write_text(words)
    return str(path)


def stored(folder: Path, name: str, **fields: Any) -> str:
    path = folder / name
    if path.suffix == ".mat":
        savemat(path, fields)
    elif path.suffix == ".npz":
        np.savez(path, **fields)
    else:
        path.write_text(json.dumps(fields))
    return str(path)


def after_rest(model: Any, u: np.ndarray) -> np.ndarray:
    """The run from zero inputs and outputs."""
    found: np.ndarray = model.simulate(u)
    return found


def sampled(num: list[float], den: list[float], dead_s: float) -> np.ndarray:
    """Response to U behind its hold, by a simulation a hundred times as fast, which holds the dead time."""
    fine = 100
    held = np.repeat(U[:, 0], fine)
    late = round(dead_s / DT * fine)
    held = np.concatenate([np.zeros(late), held])[: len(held)]
    a, b, c, d, _ = signal.cont2discrete(signal.tf2ss(num, den), DT / fine)
    y = signal.dlsim((a, b, c, d, DT / fine), held)[1]
    return np.asarray(y[::fine])


@pytest.mark.parametrize(
    "words",
    [
        "sys = idpoly([], [0 0.02 0.01], [], [], [1 -1.7 0.72], [], 0.02);",
        "A = [1, -1.7, 0.72]; % poles\nsys = idpoly(A, [0, 0.02, ...\n 0.01], 'Ts', 1/50)\n"
        "sys.InputName = {'theta_in'};",
        "sys = idtf([0 .02 1e-2], [1 -1.7 +0.72], 0.02);\nsys.OutputUnit = 'm/s';",
        "sys = filt([0 0.02 0.01], [1 -1.7 0.72], 0.02);",
        "sys = tf([0.02 0.01], [1 -1.7 0.72], 0.02);",
        "Ts = 0.02;\nsys = idss([1.7 -0.72; 1 0], [1 0]', [0.02, 0.01], 0, zeros(2, 1), 'Ts', Ts);",
        "sys = ss([1.7 -0.72; 1 0], [1; 0], [0.02 0.01], 0, 0.02);",
    ],
)
def test_matlab_text_of_one_system_gives_one_response(tmp_path: Path, words: str) -> None:
    model = bring(text(tmp_path / "sys.m", words), ONE)
    expected = signal.lfilter(B, F, U, axis=0)
    assert np.abs(after_rest(model, U) - expected).max() < 1e-12
    model.save(tmp_path / "sys.json")
    again = load(tmp_path / "sys.json")
    assert np.array_equal(again.simulate(U), model.simulate(U))


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".json"])
def test_fields_of_files_are_read_whatever_they_are_called(tmp_path: Path, suffix: str) -> None:
    expected = signal.lfilter(B, F, U, axis=0)
    quotient = stored(tmp_path, f"q{suffix}", num=B[1:], den=F, dt=DT)
    states = stored(
        tmp_path, f"s{suffix}", A=[[1.7, -0.72], [1.0, 0.0]], B=[[1.0], [0.0]], C=[B[1:]], D=[[0.0]], dt=DT
    )
    for source in (quotient, states):
        assert np.abs(after_rest(bring(source, ONE), U) - expected).max() < 1e-12


def test_a_struct_as_get_makes_it_in_matlab(tmp_path: Path) -> None:
    path = tmp_path / "sys.mat"
    sys = {"A": 1.0, "B": B, "C": 1.0, "D": 1.0, "F": F, "Ts": DT, "Variable": "z^-1", "TimeUnit": "seconds"}
    sys |= {"InputName": np.array(["theta_in"], object), "InputUnit": np.array(["deg"], object)}
    savemat(path, {"s": sys})
    model = bring(str(path), ONE)
    expected = signal.lfilter(B, F, np.degrees(U), axis=0)
    assert np.abs(after_rest(model, U) - expected).max() < 1e-10
    assert any("converted between rad and deg" in note for note in model.notes)


@pytest.mark.parametrize("dead", [0.0, 0.03, 0.04, 0.0568])
def test_a_continuous_system_with_any_dead_time_is_sampled_exactly(tmp_path: Path, dead: float) -> None:
    source = text(tmp_path / "sys.m", f"sys = tf([3 20], [1 2 20], 'InputDelay', {dead});")
    found = after_rest(bring(source, ONE), U)
    assert np.abs(found - sampled([3, 20], [1, 2, 20], dead)).max() < 2e-12
    with_states = text(
        tmp_path / "ss.m", f"sys = ss([-2 -20; 1 0], [1; 0], [3 20], 0, 'InputDelay', {dead});"
    )
    assert np.allclose(after_rest(bring(with_states, ONE), U), found, atol=1e-12)


def test_several_inputs_and_outputs_are_matched_by_name(tmp_path: Path) -> None:
    u = np.random.default_rng(4).normal(size=(200, 2))
    source = text(
        tmp_path / "sys.m",
        """sys = idtf({[0 1], [0 2]; [0 3], [0 4]}, {[1 -0.5], [1 -0.6]; [1 -0.7], [1 -0.8]}, 0.02, ...
             'IODelay', [0 1; 0 3]);
        sys.InputName = {'b'; 'a'};
        sys.OutputName = {'q', 'p'};""",
    )
    model = bring(source, TWO)

    def part(gain: float, pole: float, late: int, column: int) -> np.ndarray:
        return np.asarray(signal.lfilter([0.0] * (late + 1) + [gain], [1.0, -pole], u[:, column]))

    q = part(1, 0.5, 0, 1) + part(2, 0.6, 1, 0)
    p = part(3, 0.7, 0, 1) + part(4, 0.8, 3, 0)
    assert np.allclose(after_rest(model, u), np.stack([p, q], axis=1), atol=1e-12)


def test_offsets_stand_beside(tmp_path: Path) -> None:
    source = stored(tmp_path, "sys.json", num=[0.1], den=[1.0, -0.9], dt=DT, u0=[2.0], y0=[5.0])
    model = bring(source, ONE)
    u = np.full((400, 1), 3.0)
    assert after_rest(model, u)[-1, 0] == pytest.approx(6.0)


def test_a_free_run_starts_from_the_state_that_fits_the_window_best(tmp_path: Path) -> None:
    model = bring(text(tmp_path / "sys.m", "sys = tf([0.02 0.01], [1 -1.7 0.72], 0.02);"), ONE)
    y = signal.lfilter(B, F, U[:, 0], zi=np.array([3.0, -2.0]))[0][:, None]
    noisy = y + 0.02 * np.random.default_rng(5).normal(size=y.shape)
    run = model.free_run(Segment(U, noisy, 0, "a"))  # type: ignore[attr-defined]
    assert np.abs(run - y)[30:].max() < 0.05
    ahead = model.predict(U, noisy, 10)
    first = model.n_init + 9
    assert np.isnan(ahead[:first]).all()
    assert np.isfinite(ahead[first:]).all()


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ("sys = idpoly([1 -0.9], [0 1], [], [], [], [], 0.01);", "sample time 0.01 s, the data 0.02 s"),
        ("sys = idpoly([1 -0.9], [0 1]);", "no sample time"),
        ("sys = tf([1 0 0], [1 2]);", "improper"),
        ("sys = tf([1], [1 2]);\nsys.InputName = 'phi_in';", "inputs are phi_in, the data's theta_in"),
        ("sys = tf([1], [1 2]);\nsys.OutputUnit = 'deg';", "v_x in 'deg', the data in 'm/s'"),
        ("sys = tf({1, 2}, {[1 2], [1 3]});", r"2 inputs and 1 output, the data 1 and 1"),
        ("sys = tf(1);", "num and den"),
        ("sys = zpk([], [0.9], 1, 0.02);", r"zpk\(\) is not known"),
        ("a = 1;\nsystem('rm -rf /');", "line 2"),
        ("sys = tf([1 2", "line 1: the statement ends early"),
        ("x = y + 1;", "'y' is not understood"),
        ("sys = tf(1, [1 2]); other = tf(1, [1 3]);", "makes 2 models"),
        ("A = [1 2; 3];", "not understood"),
        ("sys = ss([1 2; 3 4], [1; 2; 3], [1 0], 0, 0.02);", "do not fit each other"),
        ("sys = tf([1], [1 2]); sys.TimeUnit = 'milliseconds';", "times are in milliseconds"),
        (
            "sys = idpoly({[1 -0.5], [0 1]; [0], [1 -0.5]}, {[0 1]; [0 1]}, [], [], [], [], 0.02);",
            "feed each",
        ),
        ("k = 3;", "no linear system"),
    ],
)
def test_what_cannot_be_taken_over_is_named(tmp_path: Path, words: str, match: str) -> None:
    with pytest.raises(FlysidError, match=match):
        bring(text(tmp_path / "sys.m", words), ONE)


def test_damaged_and_strange_files_are_refused_and_nothing_of_them_is_run(tmp_path: Path) -> None:
    (tmp_path / "cut.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(20))
    with pytest.raises(FlysidError, match="damaged"):
        bring(str(tmp_path / "cut.mat"), ONE)
    np.savez(tmp_path / "object.npz", A=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FlysidError, match="allow_pickle=False"):
        bring(str(tmp_path / "object.npz"), ONE)
    (tmp_path / "new.mat").write_bytes(b"MATLAB 7.3 MAT-file, Platform".ljust(124) + b"\x00\x02IM" + bytes(8))
    with pytest.raises(FlysidError, match="version 7"):
        bring(str(tmp_path / "new.mat"), ONE)
    with pytest.raises(FlysidError, match="No such file"):
        bring(str(tmp_path / "gone.mat"), ONE)
    with pytest.raises(FlysidError, match="no form"):
        bring(text(tmp_path / "model.slx", ""), ONE)
