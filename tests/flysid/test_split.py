import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.dataset import Dataset, Segment, Signal
from flysid.errors import DataError, StoreError, UsageError
from flysid.split import Split, plan_folds, plan_held, plan_split

DT = 0.02


def flight(name: str, samples: int = 1000, seed: int = 0, t0_s: float = 0.0) -> Segment:
    rng = np.random.default_rng(seed)
    return Segment(rng.normal(size=samples), rng.normal(size=samples), t0_ns=round(t0_s * 1e9), flight=name)


def data(*segments: Segment) -> Dataset:
    return Dataset(DT, (Signal("u"),), (Signal("y"),), segments)


def stamps(part: Dataset) -> set[tuple[str, int]]:
    return {
        (s.flight, int(k))
        for s in part.segments
        for k in np.round(s.time_s(part.dt_s) / part.dt_s).astype(int)
    }


def test_three_flights_split_by_flight() -> None:
    train, test = data(*(flight(f"f{i}", seed=i) for i in range(3))).split(holdout=0.3, seed=7)
    assert len(train.flights) == 2
    assert len(test.flights) == 1
    assert not set(train.flights) & set(test.flights)


def test_one_flight_splits_by_time_with_a_guard() -> None:
    whole = data(flight("f", 5000))
    split = whole.plan_split(holdout=0.3, seed=3)
    train, test = split.apply(whole)
    assert split.by == "time"
    assert len(test) == pytest.approx(0.3 * len(whole), rel=0.02)
    t_train = np.concatenate([s.time_s(DT) for s in train.segments])
    t_test = np.concatenate([s.time_s(DT) for s in test.segments])
    assert np.abs(t_train[:, None] - t_test[None, :]).min() >= split.guard_s - DT


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.integers(30, 700), min_size=1, max_size=5),
    st.floats(0.1, 0.6),
    st.sampled_from(["flight", "time", "auto"]),
    st.integers(0, 99),
)
def test_no_sample_is_in_both_parts_and_the_split_can_be_repeated(
    lengths: list[int], holdout: float, by: str, seed: int
) -> None:
    whole = data(*(flight(f"f{i % 4}", n, seed=i, t0_s=100.0 * i) for i, n in enumerate(lengths)))
    try:
        split = plan_split(whole, holdout=holdout, by=by, seed=seed, guard_s=0.1)  # type: ignore[arg-type]
    except DataError:
        return
    train, test = split.apply(whole)
    assert not stamps(train) & stamps(test)
    assert stamps(train) | stamps(test) <= stamps(whole)
    again = Split.from_dict(json.loads(json.dumps(split.to_dict())))
    assert again == split
    assert again.apply(whole)[1].content_hash() == split.test_sha256
    assert plan_split(whole, holdout=holdout, by=by, seed=seed, guard_s=0.1) == split  # type: ignore[arg-type]


def test_another_dataset_is_refused() -> None:
    split = data(flight("a", 3000)).plan_split()
    with pytest.raises(DataError, match="not those that were split"):
        split.apply(data(flight("a", 3000, seed=1)))


def outcome(whole: Dataset, by: str, seed: int) -> tuple[set[str], str]:
    """(flights that only train, what the refusal says)."""
    try:
        train, test = whole.split(by=by, seed=seed)  # type: ignore[arg-type]
    except DataError as error:
        return set(), error.message
    return set(train.flights) - set(test.flights), ""


@pytest.mark.parametrize("by", ["flight", "time"])
def test_a_copy_of_a_training_flight_is_refused(by: str) -> None:
    flights = [flight("a", 3000, 1), flight("b", 3000, 2), flight("copy of a", 3000, 1, t0_s=500.0)]
    for seed in range(12):
        trained, refusal = outcome(data(*flights), by, seed)
        if by == "time" or refusal:
            assert "copy of a" in refusal
            assert "'a'" in refusal
        else:
            assert {"a", "copy of a"} <= trained


def test_a_log_that_overlaps_a_training_log_is_refused() -> None:
    long = flight("long", 4000, 5)
    part = Segment(long.u[1500:3000], long.y[1500:3000], flight="part of it")
    whole = data(long, part, flight("other", 3000, 6))
    outcomes = [outcome(whole, "flight", seed) for seed in range(8)]
    assert any(refusal for _, refusal in outcomes)
    assert all("part of it" in refusal or {"long", "part of it"} <= trained for trained, refusal in outcomes)


def test_one_flight_from_two_recorders_is_a_copy() -> None:
    flown = flight("a.bin", 3000, 8)
    again = Segment(flown.u.astype(np.float32), flown.y.astype(np.float32), t0_ns=5, flight="a.tlog")
    whole = data(flown, again, flight("other", 3000, 9))
    outcomes = [outcome(whole, "flight", seed) for seed in range(8)]
    assert any(refusal for _, refusal in outcomes)
    assert all("a.tlog" in refusal or {"a.bin", "a.tlog"} <= trained for trained, refusal in outcomes)


def test_standing_on_the_ground_is_not_a_copy() -> None:
    still = np.zeros(1500)
    parts = []
    for i in range(3):
        moving = flight(f"f{i}", 500, seed=i)
        parts.append(
            Segment(np.append(still, moving.u[:, 0]), np.append(still, moving.y[:, 0]), flight=f"f{i}")
        )
    train, test = data(*parts).split(by="flight")
    assert len(train.flights) == 2
    assert len(test.flights) == 1


@pytest.mark.parametrize("holdout", [0.0, 1.0, -0.5, float("nan")])
def test_a_share_outside_0_to_1_is_refused(holdout: float) -> None:
    with pytest.raises(UsageError):
        data(flight("a")).split(holdout=holdout)


def test_too_little_data_is_said() -> None:
    with pytest.raises(DataError, match="too little"):
        data(flight("a", 30)).split()
    with pytest.raises(DataError, match="by flight"):
        data(flight("a", 3000)).split(by="flight")


def test_a_damaged_split_is_refused() -> None:
    document = data(flight("a", 3000)).plan_split().to_dict()
    for damage in ({"test": [[1]]}, {"seed": "x"}, {"data_sha256": None, "train": 5}):
        with pytest.raises(StoreError):
            Split.from_dict({**document, **damage})


def test_folds_hold_out_every_flight_once() -> None:
    whole = data(*(flight(f"f{i}", 100, seed=i) for i in range(7)))
    folds = plan_folds(whole, 5, seed=2)
    held = [fold.apply(whole)[1].flights for fold in folds]
    assert sorted(len(some) for some in held) == [1, 1, 1, 2, 2]
    assert sorted(f for some in held for f in some) == sorted(whole.flights)
    assert all(
        not set(fold.apply(whole)[0].flights) & set(some) for fold, some in zip(folds, held, strict=True)
    )
    assert plan_folds(whole, 5, seed=2) == folds
    with pytest.raises(DataError, match="one flight"):
        plan_folds(whole.with_segments(whole.segments[:1]), 5)
    twin = replace(whole.segments[0], flight="twin")
    with pytest.raises(DataError, match="repeats training flight"):
        plan_folds(whole.with_segments([*whole.segments, twin]), 8)


def test_what_is_named_is_held_out_with_a_guard_around_it() -> None:
    whole = data(flight("a", 2000), flight("b", 1000, seed=1))
    split = plan_held(whole, {"a": [(10 * 10**9, 20 * 10**9)]})
    train, test = split.apply(whole)
    assert (split.by, split.guard_s) == ("time", 1.0)
    assert stamps(test) == {("a", k) for k in range(500, 1000)}
    near = {k for name, k in stamps(train) if name == "a"}
    assert near == set(range(450)) | set(range(1050, 2000))
    assert {k for name, k in stamps(train) if name == "b"} == set(range(1000))
    assert split.holdout == pytest.approx(500 / 3000)
    assert Split.from_dict(split.to_dict()) == split


def test_whole_flights_that_are_named_are_held_out_by_flight() -> None:
    whole = data(flight("a"), flight("b", seed=1))
    split = plan_held(whole, {"b": [(-(10**18), 10**18)]})
    train, test = split.apply(whole)
    assert (split.by, split.guard_s, train.flights, test.flights) == ("flight", 0.0, ("a",), ("b",))


def test_holding_out_nothing_or_all_is_refused() -> None:
    whole = data(flight("a"))
    with pytest.raises(DataError, match="in what is to be held out"):
        plan_held(whole, {"b": [(0, 10**18)]})
    with pytest.raises(DataError, match="to train on"):
        plan_held(whole, {"a": [(-(10**18), 10**18)]})
