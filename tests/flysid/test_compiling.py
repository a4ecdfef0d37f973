"""Kept code is loaded without the tables of the compiler, and what is not kept is compiled as ever."""

from __future__ import annotations

import subprocess
import sys

import numba
import numpy as np
import pytest

from flysid import compiling
from tests.command import ROOT

KEPT = """
import sys
import numpy as np
from flysid.compiling import njit
from flysid.filters import apply_filter

one = np.ones(1)
apply_filter(one, one, one)
print("numba.np.npyimpl" in sys.modules, len(apply_filter.__globals__["_run_filter"].stats.cache_misses))

@njit(cache=False)
def summed(x):
    return np.linalg.norm(x)

print(summed(np.array([3.0, 4.0])))
"""


def test_kept_code_runs_without_the_tables_of_the_compiler() -> None:
    """The first process keeps the code, where none has; what the second compiles is right, too."""
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", KEPT], cwd=ROOT, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
    assert done.stdout == "False 0\n5.0\n"


@pytest.mark.parametrize("tried", [("0.68.", numba.__version__), ()])
def test_code_is_compiled_whatever_numba_it_is(
    monkeypatch: pytest.MonkeyPatch, tried: tuple[str, ...]
) -> None:
    monkeypatch.setattr(compiling, "TRIED", tried)

    @compiling.njit(cache=True)
    def doubled(x: float) -> float:
        return 2.0 * x

    assert doubled(1.5) == 3.0
    assert np.isfinite(doubled(np.float64(2.0)))
    assert isinstance(vars(doubled)["_cache"], compiling._Kept) == bool(tried)
