"""A model that answers where no flight explains it says so in its words, and when a step is explained."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import Dataset
from flysid.model.arx import ARX
from flysid.model.rules.explanation import CAUTION
from flysid.model.rules.fitted import FittedTS
from flysid.model.ts import TS
from flysid.validate.runs.fitone import fit_one

DT_S = 0.02


def flown(cut: float) -> Dataset:
    """A fast lag behind inputs without anything above a share of the sample rate, and 5 % of white noise."""
    rng = np.random.default_rng(4)
    u = np.fft.irfft(np.where(np.fft.rfftfreq(4000) < cut, np.fft.rfft(rng.normal(size=4000)), 0.0))
    u += 1e-4 * rng.normal(size=4000)
    y = lfilter([0.0, 0.7], [1.0, -0.3], u)
    return Dataset.from_arrays([u], [y + 0.05 * y.std() * rng.normal(size=4000)], DT_S)


@pytest.mark.parametrize("estimator", [ARX(na=1, nb=1, nk=1), TS(rules=1, na=1, nb=1, nk=1)])
@pytest.mark.parametrize("cut", [0.02, 0.5])
def test_words_caution_against_gains_that_no_flight_shows(
    estimator: ARX | TS, cut: float, tmp_path: Path
) -> None:
    data = flown(cut)
    model = fit_one(estimator, data, tmp_path / "m.json", {})
    assert not isinstance(model, str)
    said = [note for note in model.notes if note.startswith(CAUTION)]
    assert len(said) == (cut < 0.5)
    assert (CAUTION in (tmp_path / "m.txt").read_text("utf-8")) == (cut < 0.5)
    if said:
        assert float(said[0].split(" up to ")[1].split(" Hz")[0]) == pytest.approx(cut / DT_S, rel=0.5)
    if isinstance(model, FittedTS):
        s = data.segments[0]
        assert (CAUTION in str(model.explain(s.u, s.y, 50))) == (cut < 0.5)
