"""Last gates: what is delivered follows its own training data, in Python and through `flysid fit`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray
from flysid.errors import FitError
from flysid.model.arx import ARX
from flysid.model.fir import FIR
from flysid.model.iv import IV
from flysid.model.last_gates import HeldValue, no_worse_than_held, refuse, shortfall
from flysid.model.line import Line
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.polynarx import PolyNARX
from flysid.model.rules import judging, learning, refit
from flysid.model.rules.growth import split
from flysid.model.rules.stages import Stage
from flysid.model.selection import free_run_errors
from flysid.model.ts import TS, over_lags
from flysid.validate.runs.fitone import fit_one, fitted
from tests.model_examples import data


def arx(noise: float = 0.02) -> tuple[Dataset, FittedLinear]:
    train = data(noise=noise)
    return train, ARX(na=2, nb=2, nk=1).fit(train)


def slower(model: FittedLinear, factor: float) -> FittedLinear:
    """The model with another gain: it misses its training data."""
    return replace(model, system=replace(model.system, b=model.system.b * factor))


def test_a_model_that_follows_its_data_passes() -> None:
    train, model = arx()
    assert shortfall(model, {"itself": model}, train, margin=0.0) == ""
    assert refuse(model, {"itself": model}, train) is model


def test_what_errs_more_than_the_linear_model_is_refused_with_both_figures() -> None:
    train, model = arx()
    why = shortfall(slower(model, 0.8), {"ARX": model}, train)
    errors = free_run_errors({"own": slower(model, 0.8), "arx": model}, train)
    ratio = np.sqrt(errors["own"].mean() / errors["arx"].mean())
    assert f"errs {float(f'{ratio:.3g}'):.15g} times as much as ARX: " in why
    with pytest.raises(FitError, match="the arx model's free run over its training data errs"):
        refuse(slower(model, 0.8), {"ARX": model}, train)


def test_a_difference_within_the_margin_is_none() -> None:
    train, model = arx()
    near = slower(model, 0.999)
    assert shortfall(near, {"ARX": model}, train) == ""
    assert shortfall(near, {"ARX": model}, train, margin=0.0) != ""


def test_errors_of_rounding_are_not_compared() -> None:
    train, model = arx(noise=0.0)
    own = slower(model, 1.0 + 1e-8)
    errors = free_run_errors({"own": own, "arx": model}, train)
    assert errors["own"].mean() > 4.0 * errors["arx"].mean()
    assert shortfall(own, {"ARX": model}, train, margin=0.0) == ""


def test_a_map_without_memory_is_compared_with_the_held_value_alone() -> None:
    train, model = arx()
    line = Line().fit(train)
    errors = free_run_errors({"line": line, "arx": model}, train)
    assert errors["line"].mean() > 4.0 * errors["arx"].mean()
    assert shortfall(line, {"ARX": model}, train) == ""


def test_the_held_value_is_the_mean_of_the_window_that_starts_it() -> None:
    held = HeldValue(0.02, 2)
    assert np.array_equal(held.simulate(np.zeros((3, 1)), np.array([[1.0, 2.0]])), [[1.0, 2.0]] * 3)
    assert held.output_limits.shape == (2, 2)


def test_an_estimator_whose_model_errs_more_than_the_held_value_raises() -> None:
    train, model = arx()

    @dataclass(frozen=True)
    class Wrong:
        gain: float

        @no_worse_than_held
        def fit(self, train: Dataset) -> FittedLinear:  # noqa: ARG002
            return slower(model, self.gain)

    assert Wrong(1.0).fit(train=train).structure == "arx"
    with pytest.raises(FitError, match="times as much as the first value held"):
        Wrong(-2.0).fit(train)


def test_a_model_that_is_not_finite_is_refused() -> None:
    train = data()

    class Infinite(HeldValue):
        def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray:  # noqa: ARG002
            return np.full((len(u), 1), np.inf)

    assert "is not finite" in shortfall(Infinite(train.dt_s, 1), {}, train)


def drifting(seed: int = 0, noise: float = 0.02) -> Dataset:
    """Velocities that a thrust with a motor lag drives: three flights that only integrate."""
    rng = np.random.default_rng(seed)
    flights = []
    for _ in range(3):
        u = np.repeat(rng.uniform(-1.0, 1.0, 40), 15)
        thrust = np.zeros(600)
        for k in range(1, 600):
            thrust[k] = 0.8 * thrust[k - 1] + 0.2 * u[k - 1]
        flights.append((u, 0.05 * np.cumsum(thrust) + noise * rng.normal(size=600)))
    return Dataset.from_arrays([u for u, _ in flights], [v for _, v in flights], 0.05, name="velocity")


def of_long_lags(seed: int = 3) -> Dataset:
    """Three outputs that answer three inputs with lags of 1 to 60 s, as an evaporator does."""
    rng = np.random.default_rng(seed)
    poles = np.exp(-0.2 / np.exp(rng.uniform(0.0, np.log(60.0), (3, 3))))
    gains = rng.normal(size=(3, 3))
    u = np.repeat(rng.uniform(-1.0, 1.0, (40, 3)), 30, axis=0)
    x = np.zeros((len(u), 3, 3))
    for k in range(1, len(u)):
        x[k] = poles * x[k - 1] + (1.0 - poles) * u[k - 1]
    y = (gains * x).sum(axis=2)
    return Dataset.from_arrays(u, y + 0.01 * y.std(axis=0) * rng.normal(size=y.shape), 0.2)


@pytest.mark.parametrize("train", [drifting(), of_long_lags()], ids=["velocity", "evaporator"])
def test_a_polynomial_is_never_delivered_that_errs_more_than_its_linear_start(train: Dataset) -> None:
    linear = ARX().fit(train)
    assert shortfall(PolyNARX().fit(train), {"ARX": linear}, train, margin=0.0) == ""


@pytest.mark.usefixtures("arx_alone")
def test_on_integrating_data_one_rule_is_the_linear_model() -> None:
    train = drifting()
    linear = ARX().fit(train)
    best = TS(rules=1).fit(train)
    assert {**best.to_dict(), "notes": []} == {**linear.to_dict(), "notes": []}
    assert shortfall(over_lags(TS(rules=1), train), {"ARX": linear}, train) == ""


def test_a_split_rule_is_the_same_model() -> None:
    found = learning.lag_starts(TS(na=2, nb=2, nk=1), data(), None)
    one = found.plain.linear.stage
    three = split(one, found.context.antecedents(one.layout), 3)
    assert three is not None
    assert three.rules == 3
    for run, other in zip(one.simulated(), three.simulated(), strict=True):
        assert run == pytest.approx(other, abs=1e-12)


@pytest.mark.usefixtures("arx_alone")
def test_rules_that_refinement_drives_away_are_split_from_those_that_stay(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As on a plant that one rule describes to rounding, where what further rules follow is chance."""

    def same_rules(stage: Stage) -> bool:
        return bool(np.ptp(stage.problem.parameters(stage.body).theta, axis=0).max() < 1e-9)

    for module in (judging, refit):
        monkeypatch.setattr(module, "is_bounded", same_rules)
    train = data()
    model = over_lags(TS(rules=3, na=2, nb=2, nk=1), train)
    assert len(model.rules()) == 3
    assert shortfall(model, {"ARX": ARX(na=2, nb=2, nk=1).fit(train)}, train) == ""
    (note,) = [note for note in model.notes if "left their limits" in note]
    assert note.endswith("one rule split, without another conclusion.")


def test_instruments_of_inputs_with_other_numbers_of_lags_are_found() -> None:
    """A filter's state is as long as its own taps, not as those of the longest one."""
    train = data(2)
    linear = ARX(na=2, nb=(1, 3), nk=(1, 2)).fit(train)
    assert shortfall(IV(na=2, nb=(1, 3), nk=(1, 2)).fit(train), {"ARX": linear}, train, margin=0.5) == ""


def test_a_run_leaves_out_what_errs_more_than_its_baseline(tmp_path: Path) -> None:
    """The taps of a finite response do not add up to an integral."""
    train = drifting()
    model = fit_one(FIR(), train, tmp_path / "fir.json", {"arx": ARX().fit(train)})
    assert isinstance(model, str)
    assert " times as much as ARX: " in model
    assert not (tmp_path / "fir.json").exists()
    assert fitted(Line(), train, {"arx": ARX().fit(train)}).structure == "line"


def test_a_fault_inside_one_structure_is_its_reason(tmp_path: Path) -> None:
    class Broken:
        def fit(self, train: Dataset) -> FittedLinear:  # noqa: ARG002
            raise IndexError("list index out of range")

    found = fit_one(Broken(), data(), tmp_path / "broken.json", {})
    assert isinstance(found, str)
    assert found.startswith(
        "flysid itself failed: IndexError: list index out of range (model/test_last_gates.py"
    )
    assert "report this as a bug" in found
