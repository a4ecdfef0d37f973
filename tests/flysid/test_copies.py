"""One flight under two names is found whatever the recorder did; flights that are only alike are not."""

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.copies import find_copy
from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.errors import DataError
from flysid.ingest.align.resample import Series, decimate, hold, linear

BASE_S, DT_S, SAMPLES = 0.01, 0.04, 8000


def flown(plan: int, weather: int, white: float = 0.02, gusts: float = 0.05) -> tuple[FloatArray, FloatArray]:
    """Commands and measured outputs of 80 s at 100 Hz: a damped loop, sensor noise, correlated wind."""
    u = np.repeat(np.random.default_rng(plan).normal(size=SAMPLES // 50), 50)
    y = lfilter([0.0, 0.004, 0.004], [1.0, -1.9, 0.908], u)
    rng = np.random.default_rng(weather)
    wind = lfilter([np.sqrt(1.0 - 0.98**2)], [1.0, -0.98], rng.normal(size=SAMPLES))
    return u, y + y.std() * (white * rng.normal(size=SAMPLES) + gusts * wind)


def recorded(
    flight: tuple[FloatArray, FloatArray],
    name: str,
    every: int = 1,
    step: float = 0.0,
    cut: slice = slice(None),
    phase_ms: int = 0,
) -> Segment:
    """What a recorder keeps: every n-th sample, rounded, a part; then brought to 25 Hz as alignment does."""
    t = np.round(np.arange(SAMPLES) * BASE_S * 1e9).astype(np.int64)[cut][::every]
    u, y = (x[cut][::every] for x in flight)
    if step:
        u, y = np.round(u / step) * step, np.round(y / step) * step
    coarse = np.arange(t[0] + phase_ms * 1_000_000, t[-1], round(DT_S * 1e9), dtype=np.int64)
    ratio = max(1, round(DT_S / (every * BASE_S)))
    steps = np.arange((len(coarse) - 1) * ratio + 1)
    grid = coarse[0] + np.round(steps * (DT_S * 1e9 / ratio)).astype(np.int64)
    held, states = hold(Series(t, u), grid), linear(Series(t, y), grid)
    return Segment(decimate(held, ratio), decimate(states, ratio), t0_ns=int(coarse[0]), flight=name)


FLIGHT = flown(1, 1)
OTHERS = [recorded(flown(3, 3), "other"), recorded(flown(4, 4), "another")]
COPIES = {
    "the same file": recorded(FLIGHT, "b"),
    "on another grid": recorded(FLIGHT, "b", phase_ms=13),
    "at half the rate": recorded(FLIGHT, "b", every=2, phase_ms=7),
    "at a quarter of the rate": recorded(FLIGHT, "b", every=4),
    "rounded coarsely": recorded(FLIGHT, "b", every=2, step=0.05, phase_ms=3),
    "the last 40 % of it": recorded(FLIGHT, "b", every=2, cut=slice(4800, None)),
    "the middle third, rounded": recorded(FLIGHT, "b", every=2, step=0.02, cut=slice(2700, 5300)),
}


@pytest.mark.parametrize("case", COPIES)
def test_a_copy_is_found(case: str) -> None:
    found = find_copy([recorded(FLIGHT, "a"), OTHERS[0]], [COPIES[case], OTHERS[1]], DT_S)
    assert found is not None
    assert (found.held_out, found.training) == ("b", "a")


@pytest.mark.parametrize("unit", [1e-152, 1e150])
def test_a_copy_is_found_in_any_unit(unit: float) -> None:
    def scaled(flight: tuple[FloatArray, FloatArray], name: str, every: int = 1) -> Segment:
        return recorded((flight[0], unit * flight[1]), name, every)

    train = [scaled(FLIGHT, "a"), scaled(flown(3, 3), "other")]
    found = find_copy(train, [scaled(FLIGHT, "b", every=2)], DT_S)
    assert found is not None
    assert (found.held_out, found.training) == ("b", "a")


def test_a_flight_recorded_twice_without_noise_is_a_copy_on_any_grid() -> None:
    quiet = flown(1, 1, white=0.0, gusts=0.0)
    found = find_copy([recorded(quiet, "a"), OTHERS[0]], [recorded(quiet, "b", every=2, phase_ms=11)], DT_S)
    assert found is not None


@pytest.mark.parametrize("weather", range(12, 17))
@pytest.mark.parametrize("gusts", [0.0, 0.05, 0.3])
def test_the_same_plan_flown_again_in_other_noise_is_no_copy(weather: int, gusts: float) -> None:
    white = 0.05 if gusts == 0.0 else 0.02
    first, again = (flown(1, w, white=white, gusts=gusts) for w in (1, weather))
    assert find_copy([recorded(first, "a"), OTHERS[0]], [recorded(again, "b"), OTHERS[1]], DT_S) is None


def test_other_flights_are_no_copies_and_a_flight_is_none_of_itself() -> None:
    assert find_copy(OTHERS, [recorded(flown(s, s), f"f{s}") for s in range(5, 9)], DT_S) is None
    whole = recorded(FLIGHT, "a")
    assert find_copy([whole.slice(0, 900, DT_S)], [whole.slice(1000, 1900, DT_S)], DT_S) is None


def test_a_split_is_refused_naming_both_logs() -> None:
    segments = (recorded(FLIGHT, "log.bin"), recorded(FLIGHT, "log.tlog", every=4, phase_ms=9), *OTHERS)
    data = Dataset(DT_S, (Signal("u", "deg"),), (Signal("y", "m/s"),), segments)
    logs = {"log.bin", "log.tlog"}
    refusals = 0
    for seed in range(6):
        words, apart = outcome(data, seed)
        refusals += words != ""
        assert not words or all(name in words for name in logs)
        assert not apart & logs
    assert refusals


def outcome(data: Dataset, seed: int) -> tuple[str, set[str]]:
    """What the refusal says, or '' and the held-out flights where another part of the logs is trained on."""
    try:
        train, test = data.split(holdout=0.4, by="flight", seed=seed)
    except DataError as error:
        return error.message, set()
    both = {"log.bin", "log.tlog"} & set(train.flights)
    return "", set(test.flights) if both else set()
