"""Reviews of a few spoilt logs; row 38 of the soak tries many."""

from __future__ import annotations

import random

import pytest

from tests.review_trials import KINDS, compare

SEED = 3


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("trial", range(3))
def test_a_spoilt_log_is_reviewed(kind: str, trial: int) -> None:
    assert not compare(kind, SEED, random.Random(trial))
