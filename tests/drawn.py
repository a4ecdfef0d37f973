"""Fresh seeds, and how much chance a test may take for a fault.

A test that draws takes the fixture `fresh_seed`: it is another one in every run, and pytest prints it with
the failure. `DRAWN_SEED=123 python -m pytest FILE` repeats a run, `DRAWS=50 python -m pytest FILE` makes
fifty of each such test in FILE. Decision 33 says what a drawn test has to prove before it may stand here.
"""

from __future__ import annotations

import os
import secrets

from scipy.special import bdtr, bdtrc

SEEDS = 2**40
CHANCE = 1e-7
"""The share of runs in which one bound fails by chance: with the forty that the tests have, fewer than 1 in
100,000."""


def draws() -> int:
    """How often each drawn test is made."""
    return int(os.environ.get("DRAWS", "1"))


def draw_seed() -> int:
    """A seed that nobody has seen, or the one to be repeated."""
    return int(os.environ.get("DRAWN_SEED") or secrets.randbelow(SEEDS))


def is_rarer(failed: int, trials: int, share: float) -> bool:
    """Whether `failed` of `trials`, or more, is what chance never shows where `share` of them may fail.

    The trials are independent, and `share` is what is promised, not what was measured.
    """
    return failed > 0 and float(bdtrc(failed - 1, trials, share)) < CHANCE


def is_seldom(held: int, trials: int, share: float) -> bool:
    """Whether `held` of `trials`, or fewer, is what chance never shows where `share` of them hold."""
    return trials > 0 and float(bdtr(held, trials, share)) < CHANCE
