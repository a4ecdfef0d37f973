"""Fresh seeds and the bounds of what they show: exact, and in one place."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from tests import drawn
from tests.drawn import CHANCE, draw_seed, is_rarer, is_seldom

TESTS = Path(__file__).resolve().parents[1]
DRAWS_ITSELF = re.compile(
    r"\bsecrets\.\w*(rand|bits|choice)|SystemRandom|default_rng\(\)|Random\(\)|urandom\(\d{2,}"
)


def chance_of(failed: int, trials: int, share: float) -> float:
    """Of so many failures or more, by going through every outcome."""
    outcomes = np.array(list(product([0, 1], repeat=trials))).sum(axis=1)
    return float(np.sum((share**outcomes * (1.0 - share) ** (trials - outcomes))[outcomes >= failed]))


@pytest.mark.parametrize("share", [0.02, 0.05, 0.3])
def test_a_bound_is_the_first_count_that_chance_never_shows(share: float) -> None:
    for failed in range(13):
        rare = chance_of(failed, 12, share) < CHANCE
        assert is_rarer(failed, 12, share) == rare
        assert is_seldom(12 - failed, 12, 1.0 - share) == rare


def test_nothing_seen_is_no_fault() -> None:
    assert not is_rarer(0, 0, 0.05)
    assert not is_rarer(0, 1000, 0.05)
    assert not is_seldom(0, 0, 0.9)


def test_seeds_differ_and_one_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    assert draw_seed() != draw_seed()
    monkeypatch.setenv("DRAWN_SEED", "123")
    assert draw_seed() == 123


def test_no_test_draws_in_another_way() -> None:
    for line in (
        "secrets.randbelow(2**40)",
        "random.SystemRandom()",
        "np.random.default_rng()",
        "os.urandom(1000)",
    ):
        assert DRAWS_ITSELF.search(line), line
    own = {Path(drawn.__file__), Path(__file__)}
    found = [path for path in TESTS.rglob("*.py") if DRAWS_ITSELF.search(path.read_text("utf-8"))]
    assert set(found) <= own
