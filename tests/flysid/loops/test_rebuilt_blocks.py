"""A controller's terms, computed again block by block: as in one go, and in little memory."""

import tracemalloc

import numpy as np
import pytest

from flysid.loops.betaflight import BetaflightLaw
from flysid.loops.rebuilt import Rows, _rebuild_piece

STATED = {
    "Firmware revision": "Betaflight 4.3.0 (a) OMNIBUSF4SD",
    "looptime": "125",
    "pid_process_denom": "1",
    "rollPID": "45,80,40",
    "d_min": "30,34,0",
    "d_min_gain": "37",
    "d_min_advance": "20",
    "iterm_relax": "1",
    "iterm_relax_cutoff": "15",
    "anti_gravity_gain": "3500",
    "iterm_windup": "60",
    "tpa_rate": "65",
    "tpa_breakpoint": "1350",
    "dterm_lpf1_static_hz": "75",
    "dterm_lpf1_dyn_hz": "75,150",
    "dterm_lpf2_static_hz": "150",
}
EVERY = 16
"""Loops to a row."""


def drawn_rows(rng: np.random.Generator, count: int) -> Rows:
    def walk(size: float) -> np.ndarray:
        return np.asarray(size * np.cumsum(rng.normal(size=count)) / np.sqrt(count))

    setpoint, rate = walk(200.0), walk(200.0)
    throttle = np.clip(0.5 + walk(0.3), 0.0, 1.0)
    ones = np.ones(count)
    return Rows(
        EVERY * np.arange(count, dtype=np.float64),
        setpoint,
        setpoint,
        rate,
        throttle,
        rng.uniform(0.0, 1.2, count),
        ones,
        walk(5.0),
        np.gradient(setpoint),
        walk(20.0),
    )


@pytest.fixture
def law() -> BetaflightLaw:
    return BetaflightLaw.of(STATED, "roll")


def test_blocks_give_the_terms_of_one_go(law: BetaflightLaw) -> None:
    rows = drawn_rows(np.random.default_rng(1), 400)
    found = []
    for most in (1_000_000, 37, 512):
        terms = np.zeros((3, 400))
        sums = _rebuild_piece(law, rows, slice(0, 400), 125e-6, terms, most_loops=most)
        found.append((terms, sums))
    assert np.ptp(found[0][0], axis=1).all()
    for terms, sums in found[1:]:
        assert np.array_equal(terms, found[0][0])
        assert np.array_equal(sums[:3], found[0][1][:3])
        assert sums[3] == pytest.approx(found[0][1][3], rel=1e-12)


def test_memory_does_not_grow_with_the_loops_between_rows(law: BetaflightLaw) -> None:
    count = 20_000
    rows = drawn_rows(np.random.default_rng(2), count)
    terms = np.zeros((3, count))
    _rebuild_piece(law, rows, slice(0, 100), 125e-6, terms)  # compiles
    tracemalloc.start()
    _rebuild_piece(law, rows, slice(0, count), 125e-6, terms)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4 * 8 * EVERY * count  # four numbers to a loop: all at once they were thirteen
