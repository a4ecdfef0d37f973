"""ARX alone as the linear side, where a test is of rules, of data or of a way to a verdict.

The contest of all linear structures, which every fit of rules and every run begins with, takes seconds; it is
tried in tests/model/rules/test_one_rule.py, tests/validate/test_baseline.py and in the benches.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from flysid.model import one_rule, ts_best
from flysid.model.arx import ARX
from flysid.model.base import Estimator
from flysid.validate import fitting


def _only(nk_hint: tuple[int, ...] = ()) -> dict[str, Estimator]:
    return {"arx": ARX(nk_hint=nk_hint)}


@contextmanager
def arx_only() -> Iterator[None]:
    """Within the block only ARX competes for the baseline and for the rules' linear side."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (one_rule, ts_best, fitting):
            patch.setattr(module, "linear_rivals", _only)
        yield
