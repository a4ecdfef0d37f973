"""What holds while a model is fitted."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg  # noqa: F401 - it brings a BLAS of its own
from threadpoolctl import threadpool_info, threadpool_limits

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.datasetfile import write_dataset
from flysid.errors import FitError
from flysid.model import line
from flysid.model.threads import on_one_thread
from tests.bent_plant import flight
from tests.command import call
from tests.contest import linear_side


def threads() -> set[int]:
    """Of every BLAS in this process."""
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_every_blas_has_one_thread_while_a_model_is_fitted_and_as_many_as_before_afterwards() -> None:
    within = on_one_thread(threads)
    for before in (2, 3):
        with threadpool_limits(limits=before, user_api="blas"):
            assert within() == {1}
            assert threads() == {before}


TWO_FITS = """
import resource
from bench.fit_seconds import lagged
from flysid.model.arx import ARX
data = lagged(30_000, 1)
faults = []
for _ in range(2):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    ARX(na=3, nb=3, nk=1).fit(data)
    faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
print(faults[1])
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another allocator")
def test_pages_that_a_fit_freed_are_there_for_the_next() -> None:
    """They were given back and cleared anew, 22,000 of them: a tenth of the CPU of `flysid reproduce`."""
    done = subprocess.run([sys.executable, "-c", TWO_FITS], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 2_000


@on_one_thread
def broken(train: Dataset | None = None) -> None:  # noqa: ARG001
    raise np.linalg.LinAlgError("Singular matrix")


def moved(u: FloatArray, y: FloatArray) -> Dataset:
    names = [Signal(f"u{i}", "") for i in range(u.shape[1])]
    return Dataset.from_arrays(u, y, 0.1, inputs=names, outputs=[Signal("y", "")])


def hint_for(*data: Dataset) -> str:
    with pytest.raises(FitError, match="the numbers broke down: Singular matrix") as caught:
        broken(*data)
    return caught.value.hint


def test_the_samples_are_blamed_only_where_they_show_the_cause() -> None:
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((200, 2)), rng.standard_normal(200)
    assert hint_for(moved(u, y)).startswith("the samples show no cause")
    assert "samples" not in hint_for()
    assert hint_for(moved(u * [1.0, 0.0] + 3.0, y)) == (
        "u1 does not move: leave it out, or fly manoeuvres that move it"
    )
    assert hint_for(moved(u[:, [0, 0]] * [1.0, -2.0], y)) == (
        "one of u0, u1 follows from the others: leave it out, or move one input at a time"
    )


def test_a_fit_whose_numbers_break_down_does_not_blame_sound_flights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = [flight(200, seed, noise=0.01) for seed in range(4)]
    data = Dataset.from_arrays([u for u, _ in parts], [y for _, y in parts], 0.05, name="bent")
    write_dataset(tmp_path / "bent.parquet", data)

    def singular(*_: object) -> None:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(line, "solve", singular)
    with linear_side("arx"):
        done = call("fit", "bent.parquet", "-m", "line", "--no-rotate", "-o", "run", cwd=tmp_path)
    assert done.returncode == 0
    said = " ".join(done.stderr.split())
    assert "line could not be fitted: the numbers broke down: Singular matrix" in said
    assert "the samples show no cause" in said
    assert "jumps" not in said
