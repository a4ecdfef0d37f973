"""Settings of every estimator are refused where they are made: wrong names, wrong values."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest

import flysid
from flysid.errors import UsageError
from flysid.model.settings import Settings
from flysid.model.structures import public_names

ESTIMATORS = [getattr(flysid, name) for name in (*public_names(), "SearchSettings")]
NONSENSE = object()


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: e.__name__)
def test_a_name_that_is_no_setting_is_refused_with_the_nearest(estimator: type[Settings]) -> None:
    known = [field.name for field in dataclasses.fields(estimator)]
    with pytest.raises(UsageError, match="has no setting 'completely_else'"):
        estimator(completely_else=1)
    for name in known:
        with pytest.raises(UsageError) as caught:
            estimator(**{f"{name}x": 1})
        assert f"did you mean {name!r}?" in caught.value.hint


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: e.__name__)
def test_no_setting_takes_what_is_none_of_its_kind(estimator: type[Settings]) -> None:
    for field in dataclasses.fields(estimator):
        with pytest.raises(UsageError, match=rf"{field.name} is .*, not <object"):
            estimator(**{field.name: NONSENSE})


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: e.__name__)
def test_settings_are_copied_and_stored(estimator: type[Settings]) -> None:
    settings = estimator()
    assert copy.deepcopy(settings) == settings == pickle.loads(pickle.dumps(settings))
    assert dataclasses.replace(settings) == settings


@pytest.mark.parametrize(
    ("estimator", "given"),
    [
        (flysid.TS, {"rules": "two"}),
        (flysid.TS, {"rules": 0}),
        (flysid.TS, {"rules": 2.0}),
        (flysid.TS, {"rules": True}),
        (flysid.TS, {"search": "quick"}),
        (flysid.TS, {"antecedents": "v_x"}),
        (flysid.TS, {"antecedents": ()}),
        (flysid.TS, {"ridge": float("nan")}),
        (flysid.ARX, {"na": -1}),
        (flysid.ARX, {"nb": [1, 2.5]}),
        (flysid.ARX, {"trend": "estimate"}),
        (flysid.BJ, {"nc": 2}),
        (flysid.IV, {"reference": "u"}),
        (flysid.TF, {"hold": "none"}),
        (flysid.TF, {"trend": "quadratic"}),
        (flysid.TF, {"n_init": 0}),
        (flysid.TF, {"band": (2.0, 1.0)}),
        (flysid.TF, {"band": 3.0}),
        (flysid.FIR, {"taps": 0}),
        (flysid.StateSpace, {"order": 0}),
        (flysid.StaticTS, {"shape": "ball"}),
        (flysid.ANFIS, {"step": 1.5}),
        (flysid.Ensemble, {"of": flysid.TS}),
        (flysid.Ensemble, {"members": 1}),
    ],
    ids=lambda part: part.__name__ if isinstance(part, type) else str(part),
)
def test_values_that_cannot_be_are_refused_before_any_data(estimator: Any, given: dict[str, Any]) -> None:
    with pytest.raises(UsageError):
        estimator(**given)


def test_numbers_of_numpy_are_numbers() -> None:
    given: dict[str, Any] = {"rules": np.int64(2), "ridge": np.float32(0.5), "nb": np.array([1, 2])}
    assert flysid.TS(**given).rules == 2
    assert flysid.TF(dead_time_s=[0.1, None]).dead_time_s == [0.1, None]


def test_more_values_than_settings() -> None:
    with pytest.raises(UsageError, match="ARX has 10 settings, and 12 values are given"):
        flysid.ARX(*range(12))
