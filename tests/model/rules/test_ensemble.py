"""Ensembles: whole blocks left out, one voice per member, less variance than one member."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray
from flysid.errors import DataError, FitError, UsageError
from flysid.ingest.synth.synth import WRITERS, Order, flights
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.ensemble import Ensemble, FittedEnsemble, without_block
from flysid.model.static_ts import StaticTS
from flysid.model.ts import TS, over_lags
from tests.command import call
from tests.contest import linear_side

B = [0.0, 0.2]
A = [1.0, -0.8]
SMALL = ARX(na=1, nb=1, nk=1, refine=False)


def experiment(seed: int, samples: int = 300) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    return u, np.asarray(lfilter(B, A, u)) + 0.05 * rng.standard_normal(samples)


def test_every_sample_is_left_out_once() -> None:
    parts = [np.arange(100.0), 100.0 + np.arange(200.0)]
    data = Dataset.from_arrays(parts, parts, 0.1)
    left = [set(np.concatenate([s.y[:, 0] for s in without_block(data, b, 4).segments])) for b in range(4)]
    missing = [set(range(300)) - part for part in left]
    assert set().union(*missing) == set(range(300))
    assert sum(len(m) for m in missing) == pytest.approx(300, abs=3 * 29)


def test_the_mean_speaks_and_the_spread_is_known() -> None:
    u, y = experiment(1)
    model = Ensemble(SMALL, members=4).fit(Dataset.from_arrays(u, y, 0.1))
    runs = [m.simulate(u[:, None], y[: m.n_init, None]) for m in model.members]
    assert model.simulate(u, y[: model.n_init]) == pytest.approx(np.mean(runs, axis=0))
    assert model.spread(u, y[: model.n_init]) == pytest.approx(np.std(runs, axis=0))
    assert model.spread(u, y[: model.n_init]).max() > 0.0
    assert len(model.rules()) == 4


def test_too_few_members_and_too_short_data_are_refused() -> None:
    u, y = experiment(2)
    with pytest.raises(UsageError, match="at least 2"):
        Ensemble(SMALL, members=1).fit(Dataset.from_arrays(u, y, 0.1))
    with pytest.raises(FitError, match="too few"):
        Ensemble(SMALL, members=2).fit(Dataset.from_arrays(u[:40], y[:40], 0.1))


def test_a_run_no_longer_than_its_start_is_its_start() -> None:
    u, y = experiment(1)
    model = Ensemble(ARX(na=3, nb=1, nk=1, refine=False), members=2).fit(Dataset.from_arrays(u, y, 0.1))
    for n in (0, 1, 3):
        assert model.simulate(u[:n], y[:3]).ravel().tolist() == y[:n].tolist()


def test_what_is_no_setting_of_a_model_is_named() -> None:
    for of in (ARX, None):
        with pytest.raises(UsageError, match="of is an object of type Estimator"):
            Ensemble(of)  # type: ignore[arg-type]


def test_an_explanation_is_of_all_members_alike() -> None:
    u, y = experiment(1)
    data = Dataset.from_arrays(u, y, 0.1)
    model = Ensemble(StaticTS(rules=2), members=3).fit(data)
    told = model.explain(u, y, 50)
    assert sum(v.share for v in told.voices) == pytest.approx(1.0)
    assert told.output == pytest.approx(model.simulate(u)[50])
    assert {v.label for v in told.voices} == {f"M{i}.R{r}" for i in (1, 2, 3) for r in (1, 2)}
    with pytest.raises(UsageError, match="nothing to explain"):
        Ensemble(SMALL, members=2).fit(data).explain(u, y, 50)


@dataclass(frozen=True)
class Sometimes:
    """An estimator that fails where the first sample of the data is missing."""

    first: float

    def fit(self, train: Dataset, validation: Dataset | None = None) -> Fitted:
        if train.segments[0].y[0, 0] != self.first:
            raise DataError("not this time")
        return SMALL.fit(train, validation)


def test_members_that_fail_are_counted() -> None:
    u, y = experiment(3)
    model = Ensemble(Sometimes(float(y[0])), members=3).fit(Dataset.from_arrays(u, y, 0.1))
    assert len(model.members) == 2
    assert any("1 more could not be fitted: not this time" in note for note in model.notes)


def test_a_reason_comes_with_one_hint() -> None:
    data = Dataset.from_arrays(np.ones(300), np.arange(300.0), 0.1)
    with pytest.raises(FitError, match="never changes") as caught:
        Ensemble(StaticTS(rules=2), members=2).fit(data)
    assert str(caught.value).count("Try:") == 1


def test_an_ensemble_of_rules_is_told_in_words(tmp_path: Path) -> None:
    """A member's rule that is never the strongest at rest is told of by the member's own places at rest."""
    suffix, encode = WRITERS["tlog"]
    order = Order(plant="ardrone", plan="demo", duration_s=8.0)
    for recording in list(flights(order))[:3]:
        (tmp_path / f"{recording.name}{suffix}").write_bytes(encode(recording))
    words = (
        "-r",
        "ardrone-synthetic",
        "-c",
        "lateral",
        "-m",
        "ensemble",
        "--rules",
        "3",
        "--effort",
        "quick",
    )
    with linear_side("arx"):
        done = call("fit", ".", *words, "--no-rotate", "-j", "1", "-q", "-o", "run", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "could not be given" not in done.stderr
    text = (tmp_path / "run" / "lateral" / "ensemble.txt").read_text("utf-8")
    assert "never the strongest at rest, at most" in text
    assert call("validate", "run", cwd=tmp_path).returncode == 0


def test_a_member_that_comes_to_no_rest_is_told_by_its_own_gain() -> None:
    u, y = experiment(3)
    resting = over_lags(TS(rules=2, na=1, nb=1, nk=1), Dataset.from_arrays(u, y, 0.1))
    restless = replace(resting, operating_points=())
    told = str(FittedEnsemble((restless, resting), ())).splitlines()
    assert not any("at rest" in line for line in told if line.strip().startswith("M1."))
    assert any("at rest" in line for line in told if line.strip().startswith("M2."))
