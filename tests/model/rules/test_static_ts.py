"""The paper's static model, on the paper's loops and on maps whose truth is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import DataError, UsageError
from flysid.model.base import load
from flysid.model.static_ts import StaticTS

LOOPS = {  # (10), (11), (12): numerator, denominator, and the RMSE in m/s that must be reached
    "longitudinal": ([0.7995], [1, 4.1881, 7.1429], 0.0256),
    "lateral": ([116.24, 67.2488], [1000, 982.664, 301.338], 0.1225),
    "vertical": ([17.6902, 37.7142, 422.62], [1, 11.6091, 68.394, 257, 684.244], 0.0690),
}


def response(num: list[float], den: list[float], sines: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    from scipy.signal import lsim

    t = 0.01 * np.arange(40001)
    u = np.sum([np.sin(w * t) for w in sines], axis=0)
    return u, np.asarray(lsim((num, den), u, t)[1])


@pytest.mark.parametrize("rules", [7, 3])
@pytest.mark.parametrize("loop", list(LOOPS))
def test_paper_loops(loop: str, rules: int) -> None:
    num, den, limit = LOOPS[loop]
    u, y = response(num, den, (0.1, 0.2, 0.3, 0.4, 0.5))
    model = StaticTS(rules=rules).fit(Dataset.from_arrays(u, y, 0.01))
    v, truth = response(num, den, (0.1, 0.2, 0.3, 0.4))
    assert np.sqrt(np.mean((model.simulate(v)[:, 0] - truth) ** 2)) <= limit


def bent(n: int = 800) -> tuple[FloatArray, FloatArray]:
    u = np.random.default_rng(0).uniform(-2, 2, n)
    return u, np.abs(u) + 0.01 * np.sin(9 * u)


def test_a_bent_map_is_followed_by_few_rules() -> None:
    u, y = bent()
    model = StaticTS(rules=4).fit(Dataset.from_arrays(u, y, 0.1))
    assert np.sqrt(np.mean((model.simulate(u)[:, 0] - y) ** 2)) < 0.1 * y.std()


@pytest.mark.parametrize("shape", ["triangle", "trapezoid"])
@pytest.mark.parametrize("conjunction", ["product", "minimum"])
def test_other_shapes_fit_two_inputs(shape: str, conjunction: str) -> None:
    rng = np.random.default_rng(1)
    u = rng.uniform(-1, 1, (500, 2))
    y = u[:, 0] * u[:, 1]
    settings = StaticTS(rules=6, shape=shape, conjunction=conjunction)  # type: ignore[arg-type]
    model = settings.fit(Dataset.from_arrays(u, y, 0.1))
    assert np.sqrt(np.mean((model.simulate(u)[:, 0] - y) ** 2)) < 0.6 * y.std()


def test_several_outputs_share_the_rules() -> None:
    u, y = bent()
    model = StaticTS(rules=3).fit(Dataset.from_arrays(u, np.c_[y, -2 * y], 0.1))
    run = model.simulate(u)
    assert np.allclose(run[:, 1], -2 * run[:, 0], atol=1e-8)
    assert model.rules()[0].dc_gain.shape == (2, 1)


def test_equal_data_and_one_rule_is_the_line() -> None:
    u = np.linspace(-1, 1, 50)
    model = StaticTS(rules=1).fit(Dataset.from_arrays(u, 3 * u + 1, 0.1))
    assert np.allclose(model.consequents, [[[3.0, 1.0]]])
    assert model.rules()[0].condition == "always"


def test_json_round_trip_and_table(tmp_path: Path) -> None:
    u, y = bent()
    model = StaticTS(rules=5).fit(Dataset.from_arrays(u, y, 0.1))
    model.save(tmp_path / "m.json")
    again = load(tmp_path / "m.json")
    assert np.array_equal(again.simulate(u[:, None]), model.simulate(u))
    assert again.table() == model.table()  # type: ignore[attr-defined]
    assert np.allclose(model.firing(u, y).sum(axis=1), 1.0)


def test_bad_input_is_named() -> None:
    u, y = bent()
    with pytest.raises(DataError, match="never changes"):
        StaticTS().fit(Dataset.from_arrays(np.ones(100), np.arange(100.0), 0.1))
    with pytest.raises(UsageError, match="rules"):
        StaticTS(rules=0).fit(Dataset.from_arrays(u, y, 0.1))
    with pytest.raises(DataError, match="distinct"):
        StaticTS(rules=7).fit(Dataset.from_arrays(u[:4], y[:4], 0.1))


def test_an_explanation_adds_up() -> None:
    u, y = bent()
    model = StaticTS(rules=3).fit(Dataset.from_arrays(u, np.c_[y, -2 * y], 0.1))
    told = model.explain(u, np.c_[y, -2 * y], 7)
    assert told.antecedents == {"u(k)": u[7]}
    assert sum(v.share for v in told.voices) == pytest.approx(1.0)
    assert told.output == pytest.approx(model.simulate(u)[7])
    assert sum(v.share * v.output[1] for v in told.voices) == pytest.approx(told.output[1])
    assert told.outside == ()
    assert model.explain(np.full(3, 9.0), np.zeros((3, 2)), 0).outside == ("u(k)",)
    with pytest.raises(UsageError, match="cannot be explained"):
        model.explain(u, np.c_[y, y], len(u))


def test_records_that_do_not_fit_are_refused() -> None:
    u, y = bent()
    model = StaticTS(rules=3).fit(Dataset.from_arrays(u, y, 0.1))
    with pytest.raises(UsageError, match="20 samples and y has 19"):
        model.predict(np.zeros(20), np.zeros(19))
    with pytest.raises(UsageError, match="at least one step"):
        model.predict(np.zeros(20), np.zeros(20), k=0)
    with pytest.raises(UsageError, match="u is not an array of numbers"):
        model.simulate("far")  # type: ignore[arg-type]


def test_tables_are_those_of_the_paper() -> None:
    u = np.random.default_rng(0).uniform(-1, 1, (400, 2))
    y = np.c_[np.abs(u[:, 0]) + 0.3 * u[:, 1], u[:, 0]]
    names = [Signal("theta_in", "deg"), Signal("phi_in", "deg")]
    data = Dataset.from_arrays(u, y, 0.1, inputs=names, outputs=[Signal("v_x"), Signal("v_y")])
    model = StaticTS(rules=3).fit(data)
    lines = model.tables().splitlines()
    assert lines[0] == "Fuzzy If-Then rules of v_x"
    assert lines[2].startswith("2. If theta_in is A2 and phi_in is A2 then v_x = ")
    assert lines[6].split() == ["Rule#", "Consequent", "Offset", "Centre", "of", "cluster"]
    row = model.table(1)[2]
    gain = model.consequents[2, 1, :2]
    offset = model.consequents[2, 1, 2]
    centre = model.partition.centre[2]
    assert np.array_equal([*row.gains, row.offset, *(row.centre or ())], [*gain, offset, *centre])
    assert lines[-1].split()[0] == "3."
    printed = [float(word.strip(",")) for word in lines[-1].split()[1:]]
    assert printed == pytest.approx([*gain, offset, *centre], rel=0.06, abs=1e-12)
