"""The ablations of the search take away steps that are there."""

from __future__ import annotations

import pytest

from bench.ablations import STEPS


@pytest.mark.parametrize("name", STEPS)
def test_a_step_that_an_ablation_leaves_out_exists(name: str) -> None:
    with STEPS[name]():
        pass
