"""One flight under two names is found whatever the recorder did; flights that are only alike are not."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.errors import DataError
from flysid.ingest.align.resample import RecordedSignal, decimate, hold, linear
from flysid.leakage import copies
from flysid.leakage.alike import Grid
from flysid.leakage.copies import find_copy
from flysid.leakage.like_windows import pairs_alike
from flysid.leakage.same_flights import same_flights
from tests.flysid.plain_copies import are_same

BASE_S = 0.01
DT_S = 0.04
SAMPLES = 8000


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
        u = np.round(u / step) * step
        y = np.round(y / step) * step
    coarse = np.arange(t[0] + phase_ms * 1_000_000, t[-1], round(DT_S * 1e9), dtype=np.int64)
    ratio = max(1, round(DT_S / (every * BASE_S)))
    steps = np.arange((len(coarse) - 1) * ratio + 1)
    grid = coarse[0] + np.round(steps * (DT_S * 1e9 / ratio)).astype(np.int64)
    held = hold(RecordedSignal(t, u), grid)
    states = linear(RecordedSignal(t, y), grid)
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


def short(seed: int, rows: int, weather: int = 0, noise: float = 0.05) -> tuple[FloatArray, FloatArray]:
    """A short flight at one rate: commands held for eight samples, noise on the output."""
    u = np.repeat(np.random.default_rng(seed).normal(size=rows // 8 + 1), 8)[:rows]
    y = lfilter([0.0, 0.1, 0.1], [1.0, -1.5, 0.6], u)
    rng = np.random.default_rng((seed, weather))
    return u[:, None], (y + y.std() * noise * rng.normal(size=rows))[:, None]


def coarse(y: FloatArray, share: float = 1.0) -> FloatArray:
    step = share * np.std(y)
    return np.asarray(np.round(y / step) * step)


Recorder = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def as_it_is(u: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    return u, y


SHORT: dict[str, Recorder] = {
    "exact": as_it_is,
    "exact, coarse": lambda u, y: (u, coarse(y)),
    "exact, the output stands still half of the time": lambda u, y: (
        u,
        np.where(np.arange(len(y))[:, None] < len(y) // 2, 0.0, y),
    ),
    "exact, a second output stands still": lambda u, y: (u, np.hstack([y, np.round(y / (6 * np.std(y)))])),
}
MOVED: dict[str, Recorder] = {
    "half a sample later": lambda u, y: (u[:-1], (y[:-1] + y[1:]) / 2),
    "a third of a sample later": lambda u, y: (u[:-1], (2 * y[:-1] + y[1:]) / 3),
    "half a sample later, inputs too": lambda u, y: ((u[:-1] + u[1:]) / 2, (y[:-1] + y[1:]) / 2),
    "the end of it": lambda u, y: (u[len(u) // 4 :], y[len(u) // 4 :]),
    "from another zero": lambda u, y: (u + 0.01, y + 0.05 * np.std(y)),
    "two hundredths larger": lambda u, y: (u, 1.02 * y),
    "smoothed": lambda u, y: (u, lfilter([0.5], [1.0, -0.5], y, axis=0)),
}


@pytest.mark.parametrize("rows", [24, 40, 90, 150, 400, 1000])
@pytest.mark.parametrize("case", [*SHORT, *MOVED])
def test_a_copy_of_a_short_flight_is_found(case: str, rows: int) -> None:
    for seed in range(3):
        record = SHORT.get(case, as_it_is)
        flight = record(*short(seed, rows))
        other = record(*short(seed + 50, rows))
        copy = MOVED.get(case, as_it_is)(*flight)
        first, second, third = (
            [Segment(u, y, flight=name)]
            for name, (u, y) in zip(("a", "b", "other"), (flight, copy, other), strict=True)
        )
        for known, held in (([*first, *third], second), (second, [*first, *third])):
            found = find_copy(known, held, DT_S)
            assert found is not None
            assert {found.held_out, found.training} == {"a", "b"}


@pytest.mark.parametrize("rows", [70, 100, 150])
def test_a_third_of_a_short_flight_is_found_half_a_sample_later(rows: int) -> None:
    for seed in range(12):
        flight = short(seed, rows)
        u, y = (x[rows // 3 : 2 * rows // 3] for x in flight)
        others = [Segment(*short(seed + k, rows), flight=str(k)) for k in (50, 70, 90)]
        copy = Segment(u[:-1], (y[:-1] + y[1:]) / 2, flight="b")
        found = find_copy([Segment(*flight, flight="a"), *others], [copy], DT_S)
        assert found is not None
        assert found.training == "a"


@pytest.mark.parametrize("rows", [24, 40, 90, 150, 400])
@pytest.mark.parametrize("step", [1e-6, 0.3])
def test_short_flights_that_are_only_alike_are_no_copies(rows: int, step: float) -> None:
    for seed in range(3):
        first = short(seed, rows, noise=0.1)
        again = short(seed, rows, weather=1, noise=0.1)
        a, b, c = (
            Segment(u, coarse(y, step), flight=name)
            for name, (u, y) in zip("abc", (first, again, short(seed + 50, rows)), strict=True)
        )
        assert find_copy([a], [b, c], DT_S) is None


def test_sines_of_other_sizes_are_no_copies() -> None:
    rng = np.random.default_rng(5)
    flights = []
    for name, size in zip("abc", (1.0, 1.5, 1.25), strict=True):
        u = size * np.sin(0.2 * np.arange(100) + size)
        y = lfilter([0.0, 0.1], [1.0, -0.9], u) + 0.003 * rng.normal(size=100)
        flights.append(Segment(u[:, None], y[:, None], flight=name))
    assert find_copy(flights[:2], flights[2:], DT_S) is None


def odd_flights(seed: int) -> list[Segment]:
    """Flights of few plans and many lengths, as all the recorders above leave them, some with gaps."""
    rng = np.random.default_rng(seed)
    found: list[Segment] = []
    for k in range(8):
        rows = int(rng.choice([24, 40, 90, 150, 400, 3000]))
        u, y = short(
            int(rng.integers(3)), rows, weather=int(rng.integers(2)), noise=rng.choice([0.002, 0.05])
        )
        u, y = [as_it_is, *MOVED.values()][rng.integers(8)](u, y)
        y = coarse(y, rng.choice([0.3, 1.0])) if rng.random() < 0.3 else y
        y = np.where(np.arange(len(y))[:, None] // (rows // 3) == 1, y[0], y) if rng.random() < 0.3 else y
        y = y * rng.choice([1e-6, 1e-150, 1.05, 1.0, 1.0, 1.0]) + rng.choice([0.0, 0.0, 1e6])
        middle = len(y) // 2
        later = round((middle + int(rng.integers(200))) * DT_S * 1e9)
        found += [Segment(u[:middle], y[:middle], flight=str(k))]
        found += [Segment(u[middle:], y[middle:], flight=str(k), t0_ns=later)]
    return found


@pytest.mark.parametrize("seed", range(20))
def test_the_compiled_judge_says_what_its_rules_say(seed: int) -> None:
    every = odd_flights(seed)
    theta = copies._linear_model(every)
    known, held = (list(copies._on_grids(part, theta, DT_S).values()) for part in (every[:8], every[8:]))
    plain = {
        (i, k) for i, mine in enumerate(held) for k, theirs in enumerate(known) if are_same(theirs, mine)
    }
    assert pairs(known, held) == plain


def pairs(known: list[Grid], held: list[Grid], every_pair: int = 10**9) -> set[tuple[int, int]]:
    return {(i, k) for i, k, _ in same_flights(known, held, every_pair=every_pair)}


def test_one_copy_among_a_hundred_flights_is_found_and_no_other_is_proposed() -> None:
    flights = [Segment(*short(seed, 60 + seed % 90), flight=str(seed)) for seed in range(120)]
    long = Segment(*short(1000, 8_000), flight="long")
    copy = Segment(long.u[5000:5100], (long.y[5000:5100] + long.y[5001:5101]) / 2, flight="copy")
    assert find_copy([*flights[::2], long], flights[1::2], DT_S) is None
    for known, held in (([*flights[::2], long], [copy]), ([*flights[::2], copy], [long])):
        theta = copies._linear_model([*known, *held])
        theirs, mine = (list(copies._on_grids(part, theta, DT_S).values()) for part in (known, held))
        assert pairs(theirs, mine) <= {(0, len(known) - 1)}
    found = find_copy([*flights[::2], long], [*flights[1::2], copy], DT_S)
    assert found is not None
    assert (found.held_out, found.training) == ("copy", "long")


RATES: dict[str, Recorder] = {
    "half the rate": lambda u, y: (u, np.interp(np.arange(len(y)) + 0.3, np.arange(0, len(y), 2), y[::2, 0])),
    "a quarter": lambda u, y: (u, np.interp(np.arange(len(y)) + 0.3, np.arange(0, len(y), 4), y[::4, 0])),
    "coarse": lambda u, y: (u, coarse(y, 0.3)),
    "a clock 0.1 % off": lambda u, y: (u, np.interp(np.arange(len(y)) * 1.001, np.arange(len(y)), y[:, 0])),
}


@pytest.mark.parametrize("part", [0.5, 1.0])
@pytest.mark.parametrize("case", [*MOVED, *RATES])
def test_copies_among_very_many_flights_share_a_window(case: str, part: float) -> None:
    rng = np.random.default_rng(len(case))
    known = []
    held = []
    for k in range(8):
        u, y = short(k, 800)
        known.append(Segment(u, y, flight=f"known {k}"))
        first = int(rng.integers(0, int(800 * (1.0 - part)) + 1))
        own = slice(first, first + int(800 * part))
        u, y = {**MOVED, **RATES}[case](u[own], y[own])
        held.append(Segment(u, np.reshape(y, (len(y), 1)), flight=f"held {k}"))
    for train, test in ((known, held), (held, known)):
        theta = copies._linear_model([*train, *test])
        theirs, mine = (list(copies._on_grids(p, theta, DT_S).values()) for p in (train, test))
        judged = pairs(theirs, mine)
        assert pairs(theirs, mine, every_pair=0) == judged
        assert judged <= {(k, k) for k in range(8)}
        assert len(judged) == 8 or case in RATES
        near = set(
            pairs_alike(*([grid.y[np.isfinite(grid.y[:, 0]), 0] for grid in p] for p in (theirs, mine)))
        )
        assert len(near) <= 9  # of 64: others have no window in common, or one by chance


def test_the_model_of_many_flights_is_not_that_of_their_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of each of many flights a few rows are fitted; at its start a vehicle stands."""
    flights = []
    for k in range(40):
        u, y = short(k, 200, noise=0.01)
        u, y = np.vstack([np.zeros((60, 1)), u]), np.vstack([np.zeros((60, 1)), y])
        flights.append(Segment(u, y, flight=str(k)))
    whole = copies._linear_model(flights)
    monkeypatch.setattr(copies, "FIT_ROWS", 2000)
    some = copies._linear_model(flights)
    assert whole is not None
    assert some is not None
    left = [float(np.std(copies._left(flights[0], theta)[60:])) for theta in (whole, some)]
    assert left[1] < 1.2 * left[0]


def test_flights_with_gaps_and_short_ones_are_compared_with_all() -> None:
    flights = odd_flights(3)
    theta = copies._linear_model(flights)
    grids = list(copies._on_grids(flights, theta, DT_S).values())
    assert pairs(grids, grids, every_pair=0) == pairs(grids, grids)


def test_outputs_in_units_far_apart_are_no_copies() -> None:
    u, y = short(1, 100)
    other, again = short(2, 100)
    for known, held in ((1e6, 1e-150), (1e-150, 1e6)):
        train, test = Segment(u, known * y, flight="a"), Segment(other, held * again, flight="b")
        assert find_copy([train], [test], DT_S) is None


def test_a_part_without_samples_repeats_nothing() -> None:
    one = recorded(flown(0, 0), "one")
    none = Segment(one.u[:0], one.y[:0], flight="none")
    assert find_copy([one, none], [], DT_S) is None
    assert find_copy([one], [none], DT_S) is None
