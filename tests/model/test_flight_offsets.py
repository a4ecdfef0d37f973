"""`flysid.model.flight_offsets`: wind, trim and bias of every flight are found, left out and remembered."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flysid
from bench.flight_offsets import KINDS, as_dataset, steps
from flysid.dataset import Dataset, Segment
from flysid.errors import StoreError, UsageError
from flysid.model.flight_offsets import Piece, differ, find_offsets
from flysid.model.selection import free_run_errors
from flysid.model.start import as_modelled
from flysid.validate.diagnose.cautions import cautions

DT_S = 0.05
LAG_S = 2.85
GAIN = 2.0
WINDS = (1.5, -0.7, 0.2, -2.1, 0.9)


def in_wind(
    winds: tuple[float, ...] = WINDS, *, seed: int = 0, drag: float = 0.0, rows: int = 600
) -> Dataset:
    """Flights of a lag in wind, excited by steps; a little noise."""
    rng = np.random.default_rng(seed)
    flights = []
    for wind in winds:
        u = steps(rng, rows)
        y = np.full(rows, wind)
        for k in range(rows - 1):
            v = y[k] - wind
            y[k + 1] = y[k] + DT_S * ((GAIN * u[k] - v) / LAG_S - drag * v * abs(v))
        flights.append((u, y + 0.03 * rng.normal(size=rows)))
    return as_dataset(flights)


def rmse(model: flysid.FittedLinear, data: Dataset) -> float:
    return float(np.sqrt(free_run_errors({"": model}, data)[""].mean()))


@pytest.fixture(scope="module")
def windy() -> Dataset:
    return in_wind()


@pytest.mark.parametrize(
    "estimator",
    [flysid.ARX(), flysid.OE(), flysid.StateSpace(), flysid.ARMAX(), flysid.BJ(), flysid.IV()],
    ids=lambda e: type(e).__name__,
)
def test_every_linear_structure_finds_the_lag_and_the_gain_in_wind(
    windy: Dataset, estimator: flysid.ARX
) -> None:
    model = estimator.fit(windy)
    slowest = np.abs(model.poles).max()
    assert pytest.approx(LAG_S, rel=0.03) == -DT_S / np.log(slowest)
    assert pytest.approx(GAIN, rel=0.03) == model.dc_gain[0, 0]


def test_wind_was_a_pole_of_minutes_before() -> None:
    model = flysid.ARX(flight_offsets=False).fit(in_wind())
    assert np.abs(model.poles).max() > np.exp(-DT_S / 100.0)


def test_constants_are_the_winds(windy: Dataset) -> None:
    found = find_offsets(windy)
    assert found is not None
    winds = np.array(WINDS) - np.mean(WINDS)
    assert np.array([v[0] for v in found.values.values()]) == pytest.approx(winds, abs=0.03)


def test_notes_name_the_constants(windy: Dataset) -> None:
    note = flysid.ARX().fit(windy).notes[-1]
    assert note.startswith(
        "Each of the 5 flights has a constant of its own, as wind, trim or a sensor's bias"
    )
    assert "y -2.0" in note
    assert "m/s" in note


def test_scores_leave_the_wind_of_fresh_flights_out(windy: Dataset) -> None:
    fresh = in_wind((3.0, -3.0), seed=1)
    assert rmse(flysid.ARX().fit(windy), fresh) < 0.03


def test_all_models_of_a_comparison_are_treated_alike(windy: Dataset) -> None:
    fresh = in_wind((3.0, -3.0, 1.0), seed=1)
    arx = flysid.ARX().fit(windy)
    truth = flysid.ARX(na=1, nb=1, nk=1, flight_offsets=False).fit(in_wind((0.0, 0.0), seed=2))
    compared = flysid.compare({"arx": arx, "truth": truth}, fresh, horizons=["free_run", 10])
    assert str(compared.verdict["y"].verdict) == "same"
    ahead = next(e for e in compared.entries if e.horizon == "10")
    assert ahead.models["arx"].scores.rmse < 0.1


def test_the_page_says_what_the_scores_leave_out(windy: Dataset) -> None:
    fresh = in_wind((3.0, -3.0, 1.0), seed=1)
    compared = flysid.compare([flysid.ARX().fit(windy), flysid.Line().fit(windy)], fresh)
    said = [c.text for c in cautions({"y": compared}, {})]
    assert any(text.startswith("Flights differ by constants") and "y -2.0" in text for text in said)
    plain = flysid.compare([flysid.ARX(flight_offsets=False).fit(windy), flysid.Line().fit(windy)], fresh)
    assert not any("Flights differ" in c.text for c in cautions({"y": plain}, {}))


def test_rules_find_drag_in_wind() -> None:
    train = in_wind(drag=0.3)
    fresh = in_wind((1.0, -1.0, 0.3, 0.0), seed=5, drag=0.3)
    rules = flysid.TS().fit(train)
    assert len(rules.rules()) > 1
    assert rmse(rules, fresh) < 0.8 * rmse(flysid.ARX().fit(train), fresh)


def test_what_pages_show_of_rules_is_without_the_wind() -> None:
    rules: Any = flysid.TS().fit(in_wind(drag=0.3))
    still = in_wind((0.0,), seed=9, drag=0.3).segments[0]
    windy = in_wind((2.0,), seed=9, drag=0.3).segments[0]
    seen = [as_modelled(rules, segment).y for segment in (still, windy)]
    assert seen[1] == pytest.approx(seen[0], abs=0.05)
    assert rules.firing(windy.u, seen[1]) == pytest.approx(rules.firing(still.u, seen[0]), abs=0.05)


@pytest.mark.parametrize("kind", ["drag in still air", "integrator", "lag in still air"])
def test_where_flights_do_not_differ_nothing_changes(kind: str) -> None:
    data = KINDS[kind][1](np.random.default_rng(3)).data
    ours = flysid.ARX().fit(data)
    theirs = flysid.ARX(flight_offsets=False).fit(data)
    assert ours.to_dict() == theirs.to_dict()


def test_a_biased_input_makes_an_integrator_drift() -> None:
    data = KINDS["integrator with a bias"][1](np.random.default_rng(4)).data
    model = flysid.ARX().fit(data)
    assert model.flight_offsets is not None
    assert model.flight_offsets.drifting == (True,)
    assert "m/s/s" in model.notes[-1]


def test_a_controller_that_holds_against_the_wind() -> None:
    data = KINDS["speed held in wind"][1](np.random.default_rng(5)).data
    assert flysid.ARX().fit(data).dc_gain[0, 0] == pytest.approx(GAIN, rel=0.05)
    plain = flysid.ARX(flight_offsets=False).fit(data)
    assert plain.dc_gain[0, 0] != pytest.approx(GAIN, rel=0.2)


def test_one_flight_has_no_constant_of_its_own(windy: Dataset) -> None:
    assert find_offsets(windy.with_segments(windy.segments[:1])) is None


@pytest.mark.parametrize("is_named", [True, False])
def test_flights_of_a_validation_part_lose_their_own_winds(windy: Dataset, is_named: bool) -> None:
    """Not the common part, which the model has, and not the wind of a training flight in the same place."""
    long = in_wind((5.0,), rows=3000).segments[0]  # the mean of the flights is not that of the samples
    train = _renamed([*windy.segments, long], windy, "flight" if is_named else "")
    found = find_offsets(train)
    assert found is not None
    winds = (3.0, -3.0, 1.0)
    other = _renamed(in_wind(winds, seed=1).segments, windy, "other" if is_named else "")
    taken = [s.y - t.y for s, t in zip(other.segments, found.taken_out(other).segments, strict=True)]
    assert [y.mean() for y in taken] == pytest.approx(np.array(winds) - np.mean([*WINDS, 5.0]), abs=0.05)


def _renamed(segments: Sequence[Segment], data: Dataset, name: str) -> Dataset:
    """The segments as flights of this name and a number; without a name where that is empty."""
    return data.with_segments([replace(s, flight=name and f"{name} {k}") for k, s in enumerate(segments)])


def test_segments_of_one_flight_share_its_constant(windy: Dataset) -> None:
    halves = [
        Segment(s.u[rows], s.y[rows], flight=s.flight)
        for s in windy.segments
        for rows in (slice(0, 300), slice(300, 600))
    ]
    found = find_offsets(windy.with_segments(halves))
    assert found is not None
    assert len(found.values) == len(WINDS)


def test_forced(windy: Dataset) -> None:
    still = in_wind((0.0, 0.0, 0.0))
    assert flysid.ARX().fit(still).flight_offsets is None
    assert flysid.ARX(flight_offsets=True).fit(still).flight_offsets is not None
    with pytest.raises(UsageError, match=r"flight_offsets is .*, not 'yes'"):
        flysid.ARX(flight_offsets="yes").fit(windy)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "estimator",
    [flysid.ARX(), flysid.StateSpace(), flysid.TS(rules=2), flysid.PolyNARX()],
    ids=lambda e: type(e).__name__,
)
def test_a_saved_model_remembers(windy: Dataset, tmp_path: Path, estimator: flysid.ARX) -> None:
    model = estimator.fit(windy)
    model.save(tmp_path / "model.json")
    again: Any = flysid.load(tmp_path / "model.json")
    assert again.flight_offsets == model.flight_offsets
    assert again.free_run(windy.segments[0]) == pytest.approx(model.free_run(windy.segments[0]))


@pytest.mark.parametrize("damage", ['"drifting": []', '"drifting": [true, false]'])
def test_a_damaged_constant_is_refused(windy: Dataset, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "model.json"
    flysid.ARX().fit(windy).save(path)
    document = json.loads(path.read_text())
    document["flight_offsets"] |= json.loads("{" + damage + "}")
    path.write_text(json.dumps(document))
    with pytest.raises(StoreError, match="flight_offsets"):
        flysid.load(path)


def test_a_static_curve_explains_what_flights_at_other_speeds_differ_by() -> None:
    rng = np.random.default_rng(6)
    pieces = [
        Piece(f"{flight}", 0.1 * place**3 + 0.01 * rng.normal(), place, 2.0 * place)
        for flight, speed in enumerate((-3.0, -1.0, 1.0, 3.0, 2.0))
        for place in speed + 0.3 * rng.normal(size=4)
    ]
    assert not differ(pieces)


def test_constants_beside_one_place_are_the_flights_own() -> None:
    rng = np.random.default_rng(7)
    pieces = [
        Piece(f"{flight}", own + 0.01 * rng.normal(), rng.normal(), rng.normal())
        for flight, own in enumerate((0.5, -0.3, 0.1))
        for _ in range(4)
    ]
    assert differ(pieces)
    assert not differ([Piece(p.flight, float(rng.normal()), p.push, p.level) for p in pieces])


@pytest.mark.parametrize(("flights", "each"), [(2, 3), (2, 4), (3, 3)])
def test_few_pieces_that_scatter_alone_do_not_make_flights_differ(flights: int, each: int) -> None:
    """At most one in 10,000 by intention; with wrong degrees of freedom it was one in 8 to 15."""
    rng = np.random.default_rng(1)
    drawn = [
        [Piece(f"{f}", *rng.normal(size=3).tolist()) for f in range(flights) for _ in range(each)]
        for _ in range(200)
    ]
    assert sum(differ(pieces) for pieces in drawn) <= 1
