from dataclasses import replace

import numpy as np
import pytest

from flysid.dataset import Dataset, Segment, Signal
from flysid.errors import UsageError
from flysid.ingest.excitation.dead_time import dead_times, delays_to_try, least_delays
from flysid.model.arx import ARX
from flysid.model.rules.search_settings import EFFORTS
from flysid.model.ts import TS, over_lags
from tests.contest import linear_side

DT = 0.02
RNG = np.random.default_rng(1)
U = np.repeat(RNG.normal(size=80), 25)
QUICK = replace(EFFORTS["quick"], highest_order=2)  # the loop's own


def late(samples: int, noise: float = 0.05, u: np.ndarray = U) -> Dataset:
    """A damped second-order loop behind a dead time of some samples, and noise."""
    from scipy.signal import lfilter

    y = lfilter([0.0, 0.004, 0.004], [1.0, -1.8, 0.816], np.concatenate([np.zeros(samples), u])[: len(u)])
    y = y + noise * y.std() * np.random.default_rng(2).normal(size=len(y))
    segment = Segment(u, y, flight="f")
    return Dataset(DT, (Signal("u", "deg"),), (Signal("y", "deg"),), (segment,), name="c")


def test_a_dead_time_is_handed_over_in_samples_and_words() -> None:
    (found,) = dead_times(late(7))
    assert found.delay is not None
    assert delays_to_try([found], 1) in [(7,), (8,), (9,)]
    assert f"the models also try nk = {found.delay.nk}" in found.words


def test_nothing_is_handed_over_where_the_data_do_not_tell() -> None:
    (found,) = dead_times(late(7, u=U + 1e-9, noise=30.0))
    assert delays_to_try([found], 1) == ()
    assert "not used" in found.words
    noise = late(0)
    many = Dataset(DT, noise.inputs * 3, noise.outputs, (Segment(np.stack([U] * 3, 1), U),))
    assert dead_times(many) == ()
    (still,) = dead_times(Dataset.from_arrays(np.zeros(2000), np.zeros(2000), DT))
    assert "no delay without a moving input" in still.words


@pytest.mark.usefixtures("arx_alone")
def test_ts_on_a_short_record_bridges_a_dead_time_handed_over_or_found_by_the_linear_side() -> None:
    train = late(7)
    test = late(7, noise=0.0)
    s = test.segments[0]
    for hint in (delays_to_try(dead_times(train), 1), ()):
        model = over_lags(TS(rules=1, nk_hint=hint, search=QUICK), train)
        assert model.layout.orders.nk[0] in (7, 8, 9)
        error = model.simulate(s.u, s.y[: model.n_init])[50:] - s.y[50:]
        assert np.std(error) < 0.1 * np.std(s.y[50:])


def test_a_dead_time_that_is_certain_is_a_floor_for_rules() -> None:
    """Second order by itself, the plant's lag is not taken for dead time, and no model answers before it."""
    assert least_delays(dead_times(late(0)), 1) == ()
    train = late(7)
    (found,) = dead_times(train)
    (floor,) = least_delays([found], 1)
    assert 5 <= floor <= 7
    assert f"rules none below {floor}" in found.words
    model = over_lags(TS(rules=1, nk_least=(floor,), search=QUICK), train)
    assert model.layout.orders.nk[0] >= floor
    with linear_side("arx"):
        asked = over_lags(TS(rules=1, nk=2, nk_least=(floor,), search=QUICK), train)
    assert asked.layout.orders.nk == (2,)


def test_a_delay_beyond_the_range_of_the_search_is_tried_where_it_is_handed_over() -> None:
    train = late(30)  # 0.6 s; the search itself ends at 0.5 s
    own = ARX().fit(train)
    handed = ARX(nk_hint=(31,)).fit(train)
    first = [int(np.flatnonzero(np.abs(m.system.b[:, 0, 0]))[0]) for m in (own, handed)]
    assert first[0] <= 26
    assert first[1] in (30, 31, 32)


@pytest.mark.parametrize("structure", [ARX, TS])
@pytest.mark.parametrize("hint", [(1, 2), (-1,), (1.5,)])
def test_a_hint_that_cannot_be_is_refused(structure: type[ARX] | type[TS], hint: tuple[int, ...]) -> None:
    with pytest.raises(UsageError, match="nk_hint"):
        structure(nk_hint=hint).fit(late(1))
    if structure is TS:
        with pytest.raises(UsageError, match="nk_least"):
            over_lags(TS(nk_least=hint), late(1))
