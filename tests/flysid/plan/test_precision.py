"""What more flying would make known: predictions that come true, and what is not predicted."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bench.plan import BANDS, axes, signals, widths_of, widths_of_rules
from bench.ts_intervals import known_model
from flysid.dataset import Dataset
from flysid.model.arx import ARX
from flysid.model.transfer_function import TF
from flysid.plan.precision import Known, band_of_models, known_of_channel, known_of_model
from tests.fakes import FirstOrder, flown


def known(share: float, seconds: float = 60.0) -> Known:
    return Known("c", "arx", "gain of u to y", 2.0, "deg", 2.0 * share, seconds)


def test_an_interval_shrinks_with_the_square_root_of_the_time() -> None:
    assert known(0.08).share_after(180.0) == pytest.approx(0.04)
    assert known(0.08).seconds_for(0.04) == pytest.approx(180.0)
    assert known(0.08).seconds_for(0.1) == 0.0
    assert known(0.08).words(180.0, 0.04) == (
        "gain of u to y 2 deg: known to 8 % from 60 s; 3 min more of the same make it 4 %; "
        "4 % takes 3 min more."
    )


def test_a_figure_that_is_not_known_is_not_carried_further() -> None:
    vague = known(1.3)
    assert not vague.is_determined
    assert "no better than 130 %" in vague.words(180.0)
    assert "fly a plan" in vague.words(180.0)
    assert "make it" not in vague.words(180.0)


def test_predicted_widths_come_true() -> None:
    for seed in range(5):
        _, predicted, came = widths_of(seed, ARX(na=2, nb=2, nk=1))
        assert predicted == pytest.approx(came, rel=0.3)


def test_predicted_widths_of_rules_come_true() -> None:
    both = widths_of_rules(1000, known_model())
    assert len(both) == 2
    for _, predicted, came in both:
        assert predicted == pytest.approx(came, rel=0.3)


def test_gains_of_an_arx_and_of_transfer_functions() -> None:
    data = flown(FirstOrder(a=0.9, b=0.1), [600], noise=0.05)
    seconds = 600 * data.dt_s
    for model in (ARX(na=1, nb=1, nk=1).fit(data), TF(poles=1, zeros=0, dead_time_s=0.0).fit(data)):
        found = list(known_of_model(model, seconds))
        assert [k.what for k in found] == [f"gain of {data.inputs[0].name} to {data.outputs[0].name}"]
        assert abs(found[0].value - 1.0) <= 2.0 * found[0].half_width
        assert 0.0 < found[0].share < 0.2


def test_a_linear_model_in_place_of_rules_says_nothing_twice() -> None:
    data = flown(FirstOrder(a=0.9, b=0.1), [600], noise=0.05)
    model = ARX(na=1, nb=1, nk=1).fit(data)
    channel = SimpleNamespace(name="c", baseline="arx")
    held: Any = SimpleNamespace(channel=channel, models={"arx": model, "ts": model}, train=data, test=data)
    assert [k.model for k in known_of_channel(held)] == ["arx"]


def test_an_integrator_has_no_gain_to_know() -> None:
    rng = np.random.default_rng(3)
    u = rng.standard_normal(800)
    data = Dataset.from_arrays(u, np.cumsum(np.append(0.0, u[:-1])) * 0.1, 0.1)
    model = ARX(na=1, nb=1, nk=1).fit(data)
    assert all(not k.is_determined or math.isfinite(k.value) for k in known_of_model(model, 80.0))


def test_the_band_lies_around_the_poles() -> None:
    data = flown(FirstOrder(a=0.9, b=0.1), [600], noise=0.01)
    model = ARX(na=1, nb=1, nk=1).fit(data)
    band = band_of_models([model])
    assert band is not None
    speed = -math.log(0.9) / data.dt_s / (2 * math.pi)
    assert band == pytest.approx((0.3 * speed, 3.0 * speed), rel=0.1)
    assert band_of_models([]) is None


def test_the_bench_prints_its_figures(capsys: pytest.CaptureFixture[str]) -> None:
    signals(BANDS[:1])
    axes(1, 5)
    shown = capsys.readouterr().out
    assert "correlation" in shown
    assert "width from one record" in shown
