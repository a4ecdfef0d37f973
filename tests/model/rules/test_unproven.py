"""Rules whose advantage on held-out training data is noise, or that run away there, are not kept."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from flysid.dataset import Dataset, FloatArray
from flysid.model.last_gates import LINEAR_ENOUGH
from flysid.model.one_rule import linear_choice
from flysid.model.rules.contest import unproven
from flysid.model.rules.search_settings import EFFORTS
from flysid.model.selection import free_run_errors
from flysid.model.ts import TS


@dataclass(frozen=True)
class Off:
    """A model that is off by noise of its own, or that goes to its limit."""

    by: float
    seed: int
    runs_away: bool = False
    n_init: int = 1
    dt_s: float = 0.05

    @property
    def output_limits(self) -> FloatArray:
        return np.array([[-10.0], [10.0]])

    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray:
        rng = np.random.default_rng((self.seed, len(u)))
        run = u + self.by * rng.normal(size=u.shape)
        run[: len(y0)] = y0
        if self.runs_away:
            run[-3:] = 10.0  # far from a measured range of about 6
        return run


def part(seed: int) -> Dataset:
    u = np.random.default_rng(seed).normal(size=(400, 1))
    return Dataset.from_arrays(u, u, 0.05)


PARTS = [(part(i), part(10 + i)) for i in range(4)]


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        (Off(0.2, 1), Off(0.1, 2), ""),
        (Off(0.2, 1), Off(0.2, 2), "times the linear one's error"),
        (Off(0.1, 1), Off(0.2, 2), "times the linear one's error"),
        (Off(0.2, 1), Off(0.1, 2, runs_away=True), "went to its limits"),
        (Off(0.2, 1, runs_away=True), Off(0.1, 2, runs_away=True), ""),
    ],
)
def test_the_second_is_kept_only_for_an_advantage_beyond_its_noise(
    first: Off, second: Off, said: str
) -> None:
    words = unproven(lambda _: first, lambda _: second, PARTS)
    assert said in words
    assert bool(said) == bool(words)


def test_an_end_of_travel_that_the_vehicle_reaches_too_is_no_running_away() -> None:
    parts = []
    for fit, check in PARTS:
        (s,) = check.segments
        y = np.array(s.y)
        y[-3:] = 10.0
        parts.append((fit, Dataset.from_arrays(s.u, y, 0.05)))
    stays = Off(0.2, 1, runs_away=True)
    assert unproven(lambda _: replace(stays, runs_away=False), lambda _: stays, parts) == ""


@dataclass(frozen=True)
class OffOutside(Off):
    """Near within one unit, and off by `outside` beyond."""

    outside: float = 0.0

    def simulate(self, u: FloatArray, y0: FloatArray) -> FloatArray:
        run = super().simulate(u, y0)
        run[len(y0) :] += self.outside * (np.abs(u) > 1.0)[len(y0) :]
        return run


@pytest.mark.parametrize(("outside", "said"), [(0.0, ""), (0.7, "where held-out parts leave the range")])
def test_rules_that_err_where_flights_leave_the_range_are_not_kept(outside: float, said: str) -> None:
    """Seldom enough that on all rows together they are ahead."""
    parts = []
    for fit, check in PARTS:
        (f, c) = (np.clip(part.segments[0].u, -1.0, 1.0) for part in (fit, check))
        c[100:130] *= 2.0
        parts.append((Dataset.from_arrays(f, f, 0.05), Dataset.from_arrays(c, c, 0.05)))
    first = Off(0.3, 1)
    second = OffOutside(0.1, 2, outside=outside)
    words = unproven(lambda _: first, lambda _: second, parts)
    assert words.startswith(said)
    assert bool(words) == bool(said)


def drifting(seed: int, flights: int) -> tuple[Dataset, np.random.Generator]:
    """A linear lag under wind that drifts as fast as it answers; short flights."""
    rng = np.random.default_rng(seed)
    return more(rng, flights), rng


def more(rng: np.random.Generator, flights: int) -> Dataset:
    us, ys = [], []
    for _ in range(flights):
        u = np.repeat(rng.uniform(-1.0, 1.0, 16), 10)[:150]
        y = np.zeros(150)
        for k in range(2, 150):
            y[k] = 1.5 * y[k - 1] - 0.56 * y[k - 2] + 0.06 * u[k - 1]
        wind = np.zeros(150)
        for k in range(1, 150):
            wind[k] = 0.95 * wind[k - 1] + rng.normal()
        us.append(u)
        ys.append(y + wind / 3.2 * 0.3)
    return Dataset.from_arrays(us, ys, 0.05)


@pytest.mark.usefixtures("arx_alone")
def test_rules_that_noise_chose_give_way_to_the_linear_model() -> None:
    train, rng = drifting(81, 2)
    found = TS(search=EFFORTS["quick"]).fit(train)
    assert found.notes[0].startswith(LINEAR_ENOUGH)
    assert "were found and not kept: on held-out parts of the training data" in found.notes[0]
    choice = linear_choice(TS(), train, None)
    assert choice is not None
    assert found.structure == choice[1].structure
    fresh = free_run_errors({"kept": found, "linear": choice[1]}, more(rng, 10))
    assert fresh["kept"].mean() == pytest.approx(fresh["linear"].mean())
