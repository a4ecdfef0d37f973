"""What is said of rules is what the model does, and what the plant does, at places from slow to fast."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from bench.hidden_plants import PLANTS, Plant
from bench.rule_words import own_answer, truth
from bench.ts_intervals import experiment, known_model
from flysid.dataset import Dataset, FloatArray, Signal
from flysid.model.base import OperatingPoint
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.local_models import SteadyMap
from flysid.model.rules.operating_points import describe, operating_points
from flysid.model.rules.rule_uncertainty import uncertainty
from flysid.model.ts import TS, over_lags

DRAG = PLANTS["vehicle with drag and a lagging actuator"]


@pytest.fixture(scope="module")
def flown() -> tuple[FittedTS, Dataset]:
    """A vehicle with quadratic drag, its orders given."""
    data = DRAG.dataset(tuple(range(6)), 700, 0.02)[0]
    return over_lags(TS(na=2, nb=2, nk=1, antecedents=["y(k-1)"], most_rules=4), data), data


def test_points_are_what_the_free_run_does(flown: tuple[FittedTS, Dataset]) -> None:
    model, _ = flown
    assert len(model.operating_points) == 6
    for point in model.operating_points:
        said = np.array([point.gain[0], point.reached_s[0]])
        assert said == pytest.approx(own_answer(model, point, 1e-4), rel=2e-3)


def test_points_are_found_once_and_only_when_they_are_read(
    flown: tuple[FittedTS, Dataset], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search compares many models and delivers one; the others took a third of a fit of six outputs."""
    model, data = flown
    searches = []

    def count(*given: object) -> tuple[OperatingPoint, ...]:
        searches.append(given)
        return tuple(model.operating_points)

    monkeypatch.setattr("flysid.model.rules.operating_points.operating_points", count)
    described = replace(describe(model, data), notes=())
    assert not searches
    assert type(pickle.loads(pickle.dumps(described)).operating_points) is tuple
    assert [p.output for p in described.operating_points] == 6 * [0]
    assert len(searches) == 1


def test_points_and_their_intervals_are_the_plants(flown: tuple[FittedTS, Dataset]) -> None:
    """The rules' own numbers are not: the middle one's is off by a factor of two and more."""
    model, _ = flown
    held = []
    for point in model.operating_points:
        gain, reached = truth(DRAG, float(point.outputs[0]), (-2.0, 2.0))
        assert point.gain[0] == pytest.approx(gain, rel=0.12)
        assert point.reached_s[0] == pytest.approx(reached, rel=0.12)
        held.append(point.gain_interval[0, 0] < gain < point.gain_interval[1, 0])
    assert sum(held) >= 5
    slow = min(model.operating_points, key=lambda p: abs(float(p.outputs[0])))
    own = float(model.rules()[int(slow.shares.argmax())].dc_gain[0, 0])
    assert not 0.5 < own / slow.gain[0] < 2.0


def test_sentences_lead_from_slow_to_fast_and_equal_words_are_said_once(
    flown: tuple[FittedTS, Dataset],
) -> None:
    model, _ = flown
    said = str(model).splitlines()
    sentences = [line for line in said if line.startswith("  * ")]
    assert "one unit more of u adds" in sentences[0]
    assert "a single linear model cannot describe it" in sentences[-1]
    gains = [float(v) for v in re.findall(r"adds (\S+) ", "\n".join(sentences))]
    assert gains == sorted(gains, reverse=True)
    assert len(gains) == 3  # to the left and to the right alike
    assert any(re.search(r"at rest near y = -?\d\S*: as R1", line) for line in said)
    assert sum(" y(k) = " in line for line in said) == len(model.rules())


def test_rules_that_differ_by_a_push_only_say_so() -> None:
    truth_of = known_model()
    theta = np.array([[[0.8, 0.1, -0.1]], [[0.8, 0.1, 0.1]]])
    wide = replace(truth_of, parameters=truth_of.parameters._replace(theta=theta))
    model = describe(wide, experiment(wide, 1))
    told = str(model)
    assert re.search(r"at rest near y = -?\d\S*: as R1", told)
    less, more = (float(v) for v in re.findall(r"its constant acts like (\S+) (?:less|more) u", told))
    weights = model.rules()[0].support, model.rules()[1].support
    assert weights[0] * less == pytest.approx(weights[1] * more, rel=0.01)
    assert len(model.rules()[0].here) == 1


def _delayed(delay: int) -> tuple[Dataset, float]:
    """A lag of 0.5 s behind so many samples of dead time, and the seconds to 63 % of it."""
    dt = 0.05
    u = np.repeat(np.random.default_rng(2).uniform(-1, 1, 80), 15)
    b, a, _ = cont2discrete(([2.0], [0.5, 1.0]), dt)
    late = np.concatenate([np.zeros(delay), u[: len(u) - delay]])
    y = np.asarray(lfilter(b[0], a, late)) + 0.01 * np.random.default_rng(3).standard_normal(len(u))
    return Dataset.from_arrays(u, y, dt, inputs=["u"], outputs=["y"]), 0.5 + delay * dt


@pytest.mark.parametrize("delay", [0, 3])
def test_one_rule_is_said_once_with_its_dead_time(delay: int) -> None:
    data, reached = _delayed(delay)
    model = over_lags(TS(rules=1, na=1, nb=1, nk=1 + delay), data)
    (sentence,) = [line for line in str(model).splitlines() if line.startswith("  * ")]
    point = model.operating_points[0]
    assert point.dead_s[0] == pytest.approx(0.05 * delay)
    assert ("dead time of 0.15 s" in sentence) == (delay == 3)
    assert point.reached_s[0] == pytest.approx(reached, rel=0.03)
    assert point.gain_interval[0, 0] < 2.0 < point.gain_interval[1, 0]
    assert sentence.startswith("  * One unit more of u adds ")
    assert "strongest" not in str(model)
    assert "One rule, as asked." in str(model)


def test_a_time_that_no_sample_resolves_is_a_bound() -> None:
    """ "63 % of that is reached after 0.068 s" was said of a log of 9.9 Hz."""
    dt = 0.1
    u = np.repeat(np.random.default_rng(4).uniform(-1, 1, 100), 6)
    quick = np.exp(-dt / 0.03)
    y = np.asarray(lfilter([0.0, 1.0 - quick], [1.0, -quick], u))
    y += 0.01 * np.random.default_rng(5).standard_normal(len(u))
    data = Dataset.from_arrays(u, y, dt, inputs=["u"], outputs=["y"])
    said = str(over_lags(TS(rules=1, na=1, nb=1, nk=1), data))
    assert "63 % of that is reached within one sample, 0.1 s" in said
    assert "reached after" not in said


def test_a_first_move_the_wrong_way_is_told() -> None:
    dt = 0.05
    u = np.repeat(np.random.default_rng(2).uniform(-1, 1, 80), 15)
    b, a, _ = cont2discrete(([-0.3, 1.0], [0.25, 1.0, 1.0]), dt)
    y = np.asarray(lfilter(b[0], a, u)) + 0.003 * np.random.default_rng(3).standard_normal(len(u))
    model = over_lags(TS(rules=1, na=2, nb=2, nk=1), Dataset.from_arrays(u, y, dt))
    assert "the wrong way" in str(model)


def test_an_integrating_process_has_no_places() -> None:
    u = np.repeat(np.random.default_rng(5).uniform(-1, 1, 60), 10)
    y = 0.05 * np.cumsum(np.concatenate([[0.0], u[:-1]]))
    model = over_lags(TS(rules=1, na=1, nb=1, nk=1), Dataset.from_arrays(u, y, 0.05))
    assert not model.operating_points
    assert "[integrates]" in str(model)


def test_a_condition_on_an_input_without_lags_of_its_own() -> None:
    """The second input only chooses between the rules, as an airspeed may."""
    rng = np.random.default_rng(0)
    n = 1500
    u = np.repeat(rng.normal(size=n // 10), 10)
    v = np.repeat(rng.uniform(-1.0, 1.0, size=n // 50), 50)
    y = np.zeros(n)
    for k in range(1, n):
        y[k] = 0.8 * y[k - 1] + (0.2 + 0.15 * v[k - 1]) * u[k - 1]
    y += 0.01 * rng.normal(size=n)
    data = Dataset.from_arrays(np.column_stack([u, v]), y, 0.05, inputs=[Signal("u"), Signal("v")])
    model = over_lags(TS(na=1, nb=[1, 0], nk=[1, 1], antecedents=["v"], rules=2, most_rules=2), data)
    assert model.operating_points
    for point in model.operating_points:
        low, high = point.reached_interval_s[:, 0]
        assert 0.0 < low < 0.05 / -np.log(0.8) < high < 0.3


def test_a_condition_on_an_input_leaves_times_as_unsure_as_its_lags_are_apart() -> None:
    """It switches both lags of the input at once: at saturation the answer comes 1.4 samples too late."""
    plant = PLANTS["Hammerstein"]
    data, _ = plant.dataset((0, 1), 500, 0.03)
    model = over_lags(TS(na=2, nb=2, nk=1, antecedents=["u"], rules=2, most_rules=2), data)
    numbers = SteadyMap(model.layout, model.parameters)
    points = operating_points(numbers, data, uncertainty(model, data))
    assert len(points) > 3
    for point in points:
        gain, reached = truth(plant, float(point.outputs[0]), (-5.0, 5.0))
        for true, (low, high) in (
            (gain, point.gain_interval[:, 0]),
            (reached, point.reached_interval_s[:, 0]),
        ):
            assert low < true < high < 1.6 * low


def test_truth_of_the_bench_is_what_the_plant_simulates() -> None:
    """A small step on the plant itself."""

    def settled(u: float) -> FloatArray:
        still = Plant(DRAG.rate, DRAG.limit, DRAG.sense, DRAG.dt_s, lambda _, n: np.full(n, u), DRAG.rest)
        return still.flown(0, 600, 0.0)[1]

    ends = settled(0.101)[-1], settled(0.1)[-1]
    gain, _ = truth(DRAG, float(ends[1]), (-2.0, 2.0))
    assert (ends[0] - ends[1]) / 0.001 == pytest.approx(gain, rel=0.01)
