"""Fewer linear structures in the contest, where a test is of rules, of data or of a way to a verdict.

The contest of all linear structures, which every fit of rules and every run begins with, takes seconds; it is
tried in tests/model/rules/test_one_rule.py, tests/validate/compare/test_baseline.py and in the benches.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from flysid.model import one_rule, ts_choice
from flysid.model.base import Estimator
from flysid.validate.runs import fitting
from flysid.validate.runs.fitdisk import DiskJob
from flysid.validate.runs.run import ChannelRun

RIVALS = one_rule.linear_rivals


@contextmanager
def linear_side(*labels: str) -> Iterator[None]:
    """Within the block only these compete for the baseline and for the rules' linear side."""

    def only(nk_hint: tuple[int, ...] = (), *_: object) -> dict[str, Estimator]:
        return {label: model for label, model in RIVALS(nk_hint).items() if label in labels}

    with pytest.MonkeyPatch.context() as patch:
        for module in (one_rule, ts_choice, fitting):
            patch.setattr(module, "linear_rivals", only)
        yield


def fit_beside_arx(job: fitting.MemoryJob | DiskJob) -> ChannelRun | str:
    """A channel's fit as a worker does it, where only ARX competes: patches do not reach another process."""
    with linear_side("arx"):
        return job.run()
