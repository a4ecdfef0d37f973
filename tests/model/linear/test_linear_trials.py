"""Data without answers, for every linear structure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from flysid.dataset import Dataset
from flysid.datasetfile import open_dataset, write_dataset
from flysid.errors import DataError
from flysid.model.arx import ARX
from flysid.model.fir import FIR
from flysid.model.iv import IV
from flysid.model.statespace import StateSpace
from tests.linear_trials import MORE, fits_of_short_segments, given, hopeless_fits


def test_hopeless_data_are_named_or_fitted_finitely() -> None:
    slow = ("tf", "tf, response", "far too high, oe", "delay beyond the data")  # these in the soak
    outcome = hopeless_fits({label: e for label, e in given().items() if label not in slow}, every=11)
    assert outcome.failures == []
    assert outcome.raised > outcome.trials // 5


def test_short_segments_are_named_or_fitted_finitely() -> None:
    outcome = fits_of_short_segments(given())
    assert outcome.failures == []


@pytest.mark.parametrize("estimator", [ARX(2, 2, 1), FIR(taps=5), IV(2, 2, 1), StateSpace(order=2, past=5)])
def test_what_cannot_be_learnt_from_disk_is_named_alike(
    estimator: ARX | FIR | IV | StateSpace, tmp_path: Path
) -> None:
    u, y = MORE["unexcited input"](np.random.default_rng(0))
    write_dataset(tmp_path / "data.parquet", Dataset.from_arrays(u, y, 0.02))
    with pytest.raises(DataError, match="never changes"):
        estimator.fit(open_dataset(tmp_path / "data.parquet"))
