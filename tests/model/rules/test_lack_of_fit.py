"""What a free run leaves: noise of any colour is no lack of fit, a law that rules cannot say is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from bench.hidden_plants import LINEAR, PLANTS
from bench.rule_words import truth
from flysid.dataset import Dataset, FloatArray, Segment
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.free_run_error import started_run
from flysid.model.rules.lack_of_fit import through_law
from flysid.model.ts import TS, over_lags

ONE = TS(rules=1, na=2, nb=2, nk=1)


def coloured(data: Dataset, size: float, colour: float) -> Dataset:
    """The data with drift of this size (spreads of the output) and pole added, as slow wind does."""
    rng = np.random.default_rng(5)
    segments = []
    for s in data.segments:
        drift = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], rng.standard_normal(len(s)))
        segments.append(Segment(s.u, s.y + size * s.y.std() * drift[:, None], flight=s.flight))
    return data.with_segments(segments)


def widths(model: FittedTS) -> FloatArray:
    """From end to end of the gains' intervals, in logarithms, from slow to fast."""
    ends = np.array([p.gain_interval[:, 0] for p in model.operating_points])
    return np.asarray(np.log(ends[:, 1] / ends[:, 0]))


def test_a_linear_plant_leaves_nothing_whatever_the_colour_of_its_noise() -> None:
    plant = LINEAR["linear vehicle"]
    plain = plant.dataset((1, 2, 3), 800, 0.03)[0]
    gain, _ = truth(plant, 0.1, (-2.0, 2.0))
    for data, widest in ((plain, 0.12), (coloured(plain, 0.2, 0.95), 0.5)):
        model = over_lags(ONE, data)
        for point in model.operating_points:
            assert point.gain_interval[0, 0] < gain < point.gain_interval[1, 0]
        assert widths(model).max() < widest


@pytest.mark.parametrize("name", ["Wiener", "vehicle with drag and a lagging actuator"])
def test_what_one_rule_cannot_say_is_in_its_intervals(name: str) -> None:
    """A lack in the sensor, and one in the law: of six gains the noise's intervals hold one or none."""
    plant = PLANTS[name]
    model = over_lags(ONE, plant.dataset((1, 2, 3), 800, 0.03)[0])
    true = [truth(plant, float(p.outputs[0]), (-5.0, 5.0))[0] for p in model.operating_points]
    held = [
        p.gain_interval[0, 0] < gain < p.gain_interval[1, 0]
        for p, gain in zip(model.operating_points, true, strict=True)
    ]
    assert sum(held) >= 5


def test_the_law_answers_as_small_constants_in_its_equation_do() -> None:
    data = PLANTS["vehicle with drag and a lagging actuator"].dataset((1, 2), 400, 0.02)[0]
    model = over_lags(TS(rules=2, na=2, nb=2, nk=1, antecedents=["y(k-1)-y(k-2)"]), data)
    layout, par = model.layout, model.parameters
    run = model.seen(data.segments[0].u, data.segments[0].y)
    start = run[layout.uncompared : layout.depth, : layout.n]
    moved = []
    small = 1e-6
    for way in (small, -small):
        theta = par.theta.copy()
        theta[:, 0, layout.lags.column < 0] += way
        moved.append(started_run(layout, run, start, par._replace(theta=theta)))
    own = started_run(layout, run, start, par)
    answer = through_law(layout, par, own, 0, np.ones((len(run), 1)))[:, 0]
    assert answer == pytest.approx((moved[0] - moved[1])[:, 0] / (2.0 * small), rel=1e-4, abs=1e-6)
