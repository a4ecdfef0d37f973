"""What a free run leaves: noise of any colour is no lack of fit, a law that one rule cannot say is."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from bench.hidden_plants import LINEAR, PLANTS
from flysid.dataset import Dataset, Segment
from flysid.model.rules.rule_uncertainty import scale_factor
from flysid.model.ts import TS

ONE = TS(rules=1, na=2, nb=2, nk=1)


def coloured(data: Dataset, size: float, colour: float) -> Dataset:
    """The data with drift of this size (spreads of the output) and pole added, as slow wind does."""
    rng = np.random.default_rng(5)
    segments = []
    for s in data.segments:
        drift = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], rng.standard_normal(len(s)))
        segments.append(Segment(s.u, s.y + size * s.y.std() * drift[:, None], flight=s.flight))
    return data.with_segments(segments)


def test_a_linear_plant_leaves_nothing_whatever_the_colour_of_its_noise() -> None:
    plain = LINEAR["linear vehicle"].dataset((1, 2, 3), 800, 0.03)[0]
    for data in (plain, coloured(plain, 0.2, 0.95)):
        assert scale_factor(ONE.fit(data), data) < 1.7


def test_drag_leaves_more_than_one_rule_says() -> None:
    data = PLANTS["vehicle with drag and a lagging actuator"].dataset((1, 2, 3), 800, 0.03)[0]
    assert scale_factor(ONE.fit(data), data) > 2.0


def test_an_input_that_does_nothing_does_not_matter() -> None:
    plain = LINEAR["linear vehicle"].dataset((1, 2, 3), 800, 0.03)[0]
    rng = np.random.default_rng(2)
    segments = [Segment(np.column_stack([s.u, rng.standard_normal(len(s))]), s.y) for s in plain.segments]
    two = Dataset.from_arrays([s.u for s in segments], [s.y for s in segments], plain.dt_s)
    fitted = TS(rules=1, na=2, nb=[2, 1], nk=1).fit(two)
    assert scale_factor(fitted, two) < 1.7
