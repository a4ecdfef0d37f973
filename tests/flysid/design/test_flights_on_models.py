"""Flights on the models of a run: against each model's own simulation, and through the command line."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from flysid.cli import root
from flysid.cli.fly import command
from flysid.dataset import Dataset, FloatArray
from flysid.datasetfile import open_dataset, write_dataset
from flysid.design.designed import Axis, Design, DesignMeaning, open_design
from flysid.design.drawn_plants import PlantSet, grid
from flysid.design.gain_search import Bounds
from flysid.design.identified import identify
from flysid.design.law import Gains
from flysid.design.modelflight import _fly, fly_models
from flysid.design.modelvehicles import ModelVehicle, draw_vehicles
from flysid.design.trialflight import course
from flysid.errors import DataError, UsageError
from flysid.export.lpv import to_lpv
from flysid.model.arx import ARX
from flysid.model.base import Fitted
from flysid.model.capabilities import HasDraws, LinearModel
from flysid.model.mean import Mean
from flysid.split import plan_split
from flysid.validate.compare.verdict import Verdict
from flysid.validate.runs.history import run_channels
from flysid.validate.runs.run import (
    DOCUMENT,
    REPORT,
    RUN_FILE,
    ChannelRun,
    FitSettings,
    Run,
    run_document,
    versions,
)
from tests.flysid.design.flights import DT_S, LIMIT, NOISE, good
from tests.model_examples import EXAMPLES

LAWS = (Gains(0.6, 0.4), Gains(0.8, 0.5, 0.2, 0.05, 2.0))
STEPPED = (
    "arx", "armax", "bj", "fir", "iv", "multirotor", "oe", "statespace", "statespace, late input",
    "static ts", "structured", "tf", "ts", "ts, one step", "ts_ss",
)  # fmt: skip
SAMPLES = len(course(dt_s=DT_S)[0])
PRESENT, GOAL = Gains(1.43, 4.2), Gains(1.8, 12.8, 0.1, 1.5, 1.6)


def vehicle(
    model: Fitted, *, delay_s: float = 0.0, disturbance: FloatArray | None = None, label: str = "one"
) -> ModelVehicle:
    beyond = np.zeros(SAMPLES) if disturbance is None else disturbance
    return ModelVehicle(label, to_lpv(model), delay_s, beyond)


@pytest.mark.parametrize("name", STEPPED)
def test_the_models_own_free_run_says_the_same_of_the_inputs_that_were_flown(name: str) -> None:
    fit, data = EXAMPLES[name]
    model = fit(data)
    beyond = 0.05 * np.random.default_rng(1).standard_normal(SAMPLES)
    flown = [vehicle(model), vehicle(model, delay_s=0.05, disturbance=beyond)]
    away, inputs, lost = _fly(flown, LAWS, 1.0, 2.0)
    place, _ = course(dt_s=DT_S)
    assert not lost.any()
    for t, law in np.ndindex(2, len(LAWS)):
        at = np.arange(SAMPLES) - flown[t].late_s / DT_S
        u = np.interp(at, np.arange(SAMPLES), inputs[:, t, law], left=0.0)
        whole = int(np.ceil(flown[t].late_s / DT_S))
        if flown[t].late_s > 0.0:  # the first input comes up from zero within a sample
            u[whole - 1] = 0.0 if (at[whole - 1] <= -1.0) else (1.0 + at[whole - 1]) * inputs[0, t, law]
        v = model.simulate(u[:, None])[:, 0] + flown[t].disturbance
        where = np.concatenate([[0.0], np.cumsum(0.5 * DT_S * (v[1:] + v[:-1]))])
        assert np.abs(place[:, 0] - where - away[:, t, law]).max() < 1e-6


@pytest.mark.parametrize("name", ["arx", "oe", "statespace, late input", "tf"])
def test_margins_hang_on_the_linear_models_own_response(name: str) -> None:
    fit, data = EXAMPLES[name]
    model = fit(data)
    assert isinstance(model, LinearModel)
    omega = grid(DT_S)
    own = model.frequency_response(omega).response[:, 0, 0]
    late = vehicle(model, delay_s=0.03).response(omega)
    assert np.allclose(late, own * np.exp(-0.03j * omega), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["arx", "bj", "fir", "oe", "statespace", "tf"])
def test_drawn_models_scatter_as_the_models_interval_says(name: str) -> None:
    fit, data = EXAMPLES[name]
    model = fit(data)
    assert isinstance(model, LinearModel)
    assert isinstance(model, HasDraws)
    omega = np.array([2.0, 10.0])
    sizes = np.abs([vehicle(own).response(omega) for own in model.draws(200, 1)])
    told = model.frequency_response(omega).magnitude_error[:, 0, 0]
    assert np.allclose(sizes.std(axis=0), told, rtol=0.25)


def test_the_first_vehicle_is_the_model_and_all_are_the_same_again() -> None:
    found = identify(good(), None)
    count = 5
    vehicles, notes = draw_vehicles(found, good().test, count, 3, (0.0, 0.0), SAMPLES)
    assert [v.label for v in vehicles] == ["arx"] + ["arx drawn"] * (count - 1)
    assert not notes
    again, _ = draw_vehicles(found, good().test, count, 3, (0.0, 0.0), SAMPLES)
    assert all(np.array_equal(a.disturbance, b.disturbance) for a, b in zip(vehicles, again, strict=True))
    assert vehicles[1].disturbance.std() == pytest.approx(NOISE, rel=0.2)  # the flights hold no more


def test_rules_are_drawn_too_and_a_model_without_a_distribution_flies_once() -> None:
    fit, data = EXAMPLES["ts"]
    still, line = EXAMPLES["static ts"]
    models = {"ts": fit(data), "still": still(line)}
    found = replace(identify(good(), None), models=models, train=data)
    vehicles, notes = draw_vehicles(found, data, 8, 3, (0.02, 0.04), SAMPLES)
    assert [v.label for v in vehicles] == ["ts", "still"] + ["ts drawn"] * 6
    assert "still is flown once" in " ".join(notes)
    assert all(0.02 <= v.delay_s <= 0.04 for v in vehicles)
    assert len({v.body.A.tobytes() for v in vehicles}) == 8
    flown = fly_models(vehicles, LAWS, 1.0, 2.0)
    assert len(flown) == 2
    assert all(len(row) == 8 for row in flown)
    with pytest.raises(UsageError, match="2 good models"):
        draw_vehicles(found, data, 1, 3, (0.0, 0.0), SAMPLES)


def test_draws_that_the_flights_contradict_are_no_vehicles() -> None:
    found = identify(good(), None)
    arx = found.models["arx"]
    unsure = replace(arx, covariance=1e6 * arx.covariance)  # type: ignore[attr-defined, type-var]
    doubtful = replace(found, models={"arx": unsure})
    vehicles, notes = draw_vehicles(doubtful, good().test, 5, 1, (0.0, 0.0), SAMPLES)
    assert [v.label for v in vehicles] == ["arx"]
    assert notes == ("longitudinal: 1 vehicle: no more draws agree with the flights",)


def test_an_unstable_model_is_no_vehicle() -> None:
    found = identify(good(), None)
    arx = found.models["arx"]
    runaway = replace(arx, system=replace(arx.system, a=np.array([[[1.0]], [[-1.01]]])))  # type: ignore[attr-defined, type-var]
    with pytest.raises(DataError, match="arx is not flown: it is unstable"):
        draw_vehicles(replace(found, models={"arx": runaway}), good().test, 3, 1, (0.0, 0.0), SAMPLES)


def test_a_vehicle_that_leaves_its_models_range_is_lost_and_a_turned_sign_is_turned_back() -> None:
    model = good().models["arx"]
    narrow = replace(model, output_limits=np.array([[-0.3], [0.3]]))  # type: ignore[type-var]
    away, flown = (fly_models([vehicle(m)], [GOAL], 1.0, LIMIT)[0][0] for m in (narrow, model))
    assert away.lost
    assert np.isfinite(away.ise)
    assert not flown.lost
    fallen = vehicle(good(gain=-1.0).models["arx"])
    assert fly_models([fallen], [GOAL], 1.0, LIMIT)[0][0].ise > 10.0 * flown.ise
    assert fly_models([fallen], [GOAL], -1.0, LIMIT)[0][0].ise == pytest.approx(flown.ise, rel=0.1)


# ---------------------------------------------------------------------------------- the command line


def write_run(folder: Path, data: Dataset, file: Path) -> None:
    """The mean and ARX, fitted to three quarters of the flights."""
    split = plan_split(data, by="flight", holdout=0.25)
    train, _ = split.apply(data)
    models = {"mean": Mean().fit(train), "arx": ARX(na=2, nb=2, nk=1).fit(train)}
    files = {label: f"{data.name}/{label}.json" for label in models}
    (folder / data.name).mkdir(parents=True)
    for label, model in models.items():
        model.save(folder / files[label])
    channel = ChannelRun(data.name, files, split.to_dict())
    run = Run(folder, str(file), "", data.flights, FitSettings(), (channel,), {}, versions())
    (folder / RUN_FILE).write_bytes(run_document(run))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the longitudinal channel, `present` with the present gains and `goal` without."""
    root = tmp_path_factory.mktemp("onrun")
    flights = (*good().train.segments, *good().test.segments)
    data = replace(good().train, segments=tuple(s.slice(0, 1200, DT_S) for s in flights))
    write_dataset(root / "flights.parquet", data)
    write_run(root / "run", open_dataset(root / "flights.parquet").read(), root / "flights.parquet")
    omega = grid(DT_S)
    plants = PlantSet(DT_S, omega, ("arx",), vehicle(good().models["arx"]).response(omega)[None])
    laws = {"present": PRESENT, "goal": GOAL}
    for name, own in (("present", laws), ("goal", {"goal": GOAL})):
        meanings = {law: DesignMeaning.of(gains, plants) for law, gains in own.items()}
        units = ("deg", "m/s")
        axis = Axis(
            "longitudinal",
            "theta_in",
            "v_x",
            units,
            1.0,
            DT_S,
            own,
            meanings,
            Bounds(),
            ("arx",),
            (0.05, 1.5),
        )
        design = Design("run", ("pid", "words"), (axis,))
        (root / f"{name}.json").write_text(design.files()["design.json"], "utf-8")
    return root


@pytest.fixture
def undecided(folder: Path, tmp_path: Path) -> Path:
    """The same run, with a report whose verdict is "not enough data"."""
    copy = tmp_path / "run"
    shutil.copytree(folder / "run", copy)
    free: dict[str, object] = {
        "verdict": str(Verdict.NOT_ENOUGH),
        "change_pct": None,
        "models": {},
        "unit": "m/s",
    }
    body = {"about": {"longitudinal": {"test_sha256": ""}}, "channels": {"longitudinal": {"free_run": free}}}
    (copy / REPORT).mkdir()
    (copy / REPORT / DOCUMENT).write_text(json.dumps(body), "utf-8")
    assert [c.verdict for c in run_channels(copy)] == [Verdict.NOT_ENOUGH]
    return copy


@pytest.mark.parametrize(
    "words",
    [
        ("gains", "RUN"),
        ("plan", "RUN", "--json"),
        ("design", "RUN", "--limit", str(LIMIT), "--json"),
        ("export", "RUN", "--lpv", "OUT", "--force"),
    ],
    ids=lambda words: words[0],
)
def test_no_verb_refuses_a_run_for_its_verdict(folder: Path, undecided: Path, words: tuple[str, ...]) -> None:
    """A verdict is of two models; each verb refuses for what it lacks itself, with a report or without."""

    def answer(run: Path) -> tuple[int, str]:
        places = {"RUN": str(run), "OUT": str(undecided.parent / "lpv.json")}
        done = CliRunner().invoke(root, [places.get(w, w) for w in words], standalone_mode=False)
        return done.exit_code, f"{done.stdout} {done.exception}".replace(str(run), "RUN")

    assert answer(undecided) == answer(folder / "run")


def flown(folder: Path, *words: str, design: str = "present.json") -> Result:
    told = [str(folder / design), "--on", str(folder / "run"), "-q", *words]
    return CliRunner().invoke(command, told, standalone_mode=False)


def test_fly_shows_a_design_beside_the_present_gains_on_the_runs_models(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "trials.html"
    done = flown(folder, "--vehicles", "12", "--json", "-o", str(page))
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    present, goal = told["axes"]["longitudinal"]
    assert (present["law"], goal["law"], told["vehicles"]) == ("present", "goal", 12)
    assert goal["better"] == 1.0
    assert goal["stable"]
    assert goal["lost"] == 0
    assert "the largest that was flown" in " ".join(told["notes"])
    text = page.read_text("utf-8")
    assert f"{goal['ise'][0]:.1f}," in text
    assert text.count("<svg") == 1
    assert "held-out flight" in text
    assert "Full tilt" not in text


def test_the_limit_and_the_delay_of_the_link_tell(folder: Path) -> None:
    def goal(*words: str) -> dict[str, float]:
        found: dict[str, float] = json.loads(flown(folder, "--vehicles", "4", "--json", *words).stdout)[
            "axes"
        ]["longitudinal"][1]
        return found

    free, held, late = goal("--limit", "40"), goal("--limit", "2"), goal("--limit", "40", "--delay", "0.2")
    assert free["saturated"] < 0.05 < held["saturated"]
    assert held["ise"][0] > free["ise"][0]  # type: ignore[index]
    assert late["ms"][0] > 1.2 * free["ms"][0]  # type: ignore[index]


def test_without_present_gains_there_is_nothing_to_compare_with(folder: Path) -> None:
    done = flown(folder, "--vehicles", "3", "--json", design="goal.json")
    told = json.loads(done.stdout)
    (goal,) = told["axes"]["longitudinal"]
    assert (goal["better"], goal["worse"]) == (None, None)
    assert "--old FILE" in " ".join(told["notes"])
    assert " - " in flown(folder, "--vehicles", "3", design="goal.json").stdout


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--wind", "3"), "--wind: not for a run"),
        (("--mass", "1..1.4"), "--mass: not for a run"),
        (("--delay", "0.2..0.1"), "a delay of 0.2 to 0.1 s"),
        (("--data", "elsewhere.parquet"), "elsewhere.parquet"),
    ],
)
def test_what_has_no_meaning_on_a_run_is_refused(folder: Path, words: tuple[str, ...], why: str) -> None:
    done = flown(folder, *words)
    assert why in str(done.exception)


def test_options_of_runs_are_refused_without_one(folder: Path) -> None:
    told = [str(folder / "present.json"), "--limit", "3"]
    done = CliRunner().invoke(command, told, standalone_mode=False)
    assert "--limit: not for simulated vehicles" in str(done.exception)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"channel": "lateral"}, "no channel 'lateral'"),
        ({"dt_s": 0.05}, "rates of run and design differ: 50 Hz and 20 Hz"),
        ({"input": "tilt"}, "signals of run and design differ"),
        ({"channel": -1e308}, "the design is damaged: Expected `str`, got `float` - at `$[0].channel`"),
    ],
)
def test_a_design_of_another_channel_is_refused(
    folder: Path, tmp_path: Path, changes: dict[str, object], why: str
) -> None:
    body = json.loads((folder / "present.json").read_text("utf-8"))
    body["axes"][0] |= changes
    (tmp_path / "design.json").write_text(json.dumps(body), "utf-8")
    told = [str(tmp_path), "--on", str(folder / "run")]
    done = CliRunner().invoke(command, told, standalone_mode=False)
    assert why in str(done.exception)


def test_rate_loops_and_vehicles_are_named_for_what_they_are(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "design.json").write_text('{"format": "flysid-rate-design", "version": 1}', "utf-8")
    with pytest.raises(UsageError, match="rate loops"):
        open_design(tmp_path)
    (tmp_path / "vehicle.json").write_text("{}", "utf-8")
    for name in (tmp_path, tmp_path / "vehicle.json"):
        told = [str(folder / "present.json"), "--on", str(name)]
        done = CliRunner().invoke(command, told, standalone_mode=False)
        assert "a vehicle of rates" in str(done.exception)
