"""Which stretches of a flight hold a step response, by the mode that was flown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.errors import DataError
from flysid.ingest.align.recipe import load_recipe
from flysid.validate.transfers.steps import commanded_by_sticks

STICKS = ("MANUAL", "ACRO")


def flown(*modes: str) -> Dataset:
    """A segment a mode; "" is one that no log names."""
    rng = np.random.default_rng(0)
    data = Dataset.from_arrays([rng.normal(size=9) for _ in modes], [np.zeros(9) for _ in modes], 0.1)
    marked = [
        replace(s, marks={"mode": mode} if mode else {}) for s, mode in zip(data.segments, modes, strict=True)
    ]
    return data.with_segments(marked)


def test_a_position_loop_holds_no_step_response() -> None:
    with pytest.raises(DataError, match=r"loop: not a step response\. In POSCTL no stick") as said:
        commanded_by_sticks(flown("POSCTL"), STICKS)
    assert "MANUAL or ACRO" in said.value.hint


def test_what_sticks_command_stays_and_the_rest_is_named() -> None:
    data = flown("MANUAL", "POSCTL", "", "77")
    kept, left_out = commanded_by_sticks(data, STICKS)
    assert [s.marks.get("mode") for s in kept.segments] == ["MANUAL", None, "77"]
    assert left_out == ("POSCTL",)
    assert len(commanded_by_sticks(data, ())[0]) == len(data)


@pytest.mark.parametrize("name", ["px4-rates", "px4-attitude", "ardupilot-rate", "ardupilot-attitude"])
def test_recipes_of_autopilots_say_which_modes(name: str) -> None:
    recipe = load_recipe(name)
    assert [c for c, spec in recipe.channels.items() if not spec.stick_modes] in ([], ["yaw_rate"])
