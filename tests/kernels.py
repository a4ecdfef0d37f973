"""`python -m tests.kernels`: compiles what is compiled, into the cache that all tests share.

In a fresh clone every worker of the tests would compile the same functions. `make test` has this done beside
the type check, which leaves a core idle. It ends with 1 where a compiled function was left out: add a quick
test that reaches it to QUICK. Where nothing that is compiled has changed since, nothing is done.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba
import pytest
from numba.core.dispatcher import Dispatcher

import flysid

QUICK = (
    "tests/flysid/design/test_flights_on_models.py::test_a_vehicle_that_leaves_its_models_range_is_lost_and_a_turned_sign_is_turned_back",
    "tests/flysid/design/test_trials.py::test_a_trial_is_repeatable_and_wind_costs",
    "tests/flysid/export/test_lpv.py",
    "tests/flysid/loops/test_flown_axis.py::test_a_setpoint_follows_its_limit_of_acceleration",
    "tests/flysid/loops/test_flown_axis.py::test_small_motions_answer_as_the_closed_form_says",
    "tests/flysid/loops/test_flown_axis.py::test_whether_airmode_is_on_is_read_off_the_motors",
    "tests/flysid/loops/test_term_check.py::test_the_law_of_4_2_gives_what_a_real_log_recorded",
    "tests/flysid/sixdof/test_free_runs.py",
    "tests/flysid/spectra/test_replay.py::test_rows_of_every_other_loop_are_nearly_as_good",
    "tests/ingest/formats/test_blackbox.py::test_a_wound_longer_than_any_pause_does_not_end_the_log",
    "tests/model/test_in_pieces.py::test_pieces_are_predicted_as_the_whole",
    "tests/validate/diagnose/test_detect.py::test_the_cusum_is_the_textbooks",
)
"""The quickest tests of what models, logs and links leave out."""
STAMP = Path(".pytest_cache", "kernels")
"""Names the sources that the cache was last filled from."""
REAL_LOGS = Path("../shared/logs")
"""Without them a few functions are reached by no test."""


def main() -> None:
    """Fill the cache, unless it was filled from these very sources."""
    if STAMP.exists() and STAMP.read_text("utf-8") == describe_sources():
        return
    fill()
    STAMP.parent.mkdir(exist_ok=True)
    STAMP.write_text(describe_sources(), "utf-8")


def fill() -> None:
    """Fit one model of every structure, read one log of every format, take one frame from a link."""
    from flysid.live.receiving import warm_up
    from tests.format_trials import FORMATS, intact
    from tests.model_examples import EXAMPLES, fitted

    for name in EXAMPLES:
        fitted(name)
    for name in FORMATS:
        intact(name)
    warm_up()
    failed = pytest.main(["-q", "--no-header", "-p", "no:cacheprovider", *QUICK])
    left_out = sorted(name for name, function in compiled_functions() if not is_cached(function))
    if failed or (left_out and REAL_LOGS.is_dir()):
        sys.exit(f"not compiled by any of these: {', '.join(left_out) or 'a test failed'}")


def describe_sources() -> str:
    """Numba's version, and of every compiled source its name, time and size, and how much of it is cached."""
    lines = [numba.__version__]
    for module, origin in compiled_modules():
        path = Path(origin)
        cached = sum(1 for _ in (path.parent / "__pycache__").glob(f"{path.stem}.*.nbi"))
        lines.append(f"{module} {path.stat().st_mtime_ns} {path.stat().st_size} {cached}")
    return "\n".join(lines)


def compiled_modules() -> list[tuple[str, str]]:
    """Names and paths of the modules in which something is compiled."""
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # of modules at their former places
        for module in pkgutil.walk_packages(flysid.__path__, "flysid."):
            spec = importlib.util.find_spec(module.name)
            if spec is not None and spec.origin and "njit" in Path(spec.origin).read_text("utf-8"):
                found.append((module.name, spec.origin))
    return found


def compiled_functions() -> Iterator[tuple[str, Any]]:
    """Those at the level of a module, by their names."""
    for module_name, _ in compiled_modules():
        module = importlib.import_module(module_name)
        for name, value in vars(module).items():
            if isinstance(value, Dispatcher) and value.py_func.__module__ == module.__name__:
                yield f"{module.__name__}.{name}", value


def is_cached(function: Any) -> bool:
    """Whether the cache on disk has it, for whatever types."""
    code = function.py_func.__code__
    stem = f"{Path(code.co_filename).stem}.{code.co_qualname}-{code.co_firstlineno}"
    return any(Path(function.stats.cache_path).glob(f"{stem}.*.nbi"))


if __name__ == "__main__":
    main()
