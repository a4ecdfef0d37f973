"""Gains whose meaning is known: figures against python-control, bounds kept, factors of two, refusals."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from flysid.design.designed import Design, DesignMeaning, open_design
from flysid.design.designing import Wish, _design, _new, ready_channel, with_feedforward
from flysid.design.drawn_plants import PlantSet, Spread, grid, plants_of
from flysid.design.firmware import SAFETY, SCHEMES, Firmware, firmware_for, read_parameters
from flysid.design.gain_search import Bounds, Box, search
from flysid.design.identified import identify
from flysid.design.law import Gains, LoopParts
from flysid.design.loopfigures import Laws, figures
from flysid.errors import DataError, StoreError, UsageError
from flysid.ingest.align.doubts import Doubt
from flysid.ingest.synth.manoeuvres import chirp
from flysid.ingest.synth.plants import LOOPS
from flysid.validate.runs.run import HeldOut
from tests.flysid.design.flights import DT_S, LIMIT, answer, channel, good, steps
from tests.model_examples import EXAMPLES

PUBLISHED = {"position": 1.43, "velocity": 4.2}


def known_plant() -> tuple[control.TransferFunction, PlantSet]:
    """The paper's longitudinal loop behind a hold and two samples of delay."""
    sampled = control.sample_system(LOOPS["longitudinal"].transfer_function(), DT_S, "zoh")
    late = sampled * control.tf([1.0], [1.0, 0.0, 0.0], DT_S)
    omega = grid(DT_S)
    response = np.asarray(late(np.exp(1j * omega * DT_S)))
    return late, PlantSet(DT_S, omega, ("truth",), response[None])


def closed_poles(plant: control.TransferFunction, gains: Gains) -> np.ndarray:
    """Of the whole loop, polynomial by polynomial: no frequency response in it."""
    z = control.tf([1.0, 0.0], [1.0], DT_S)
    keep = np.exp(-2.0 * np.pi * gains.cut_hz * DT_S)
    total = control.tf([DT_S, 0.0], [1.0, -1.0], DT_S)
    place = control.tf([0.5 * DT_S, 0.5 * DT_S], [1.0, -1.0], DT_S)
    slope = control.tf([(1.0 - keep), 0.0], [1.0, -keep], DT_S) * (z - 1.0) / z * (1.0 / DT_S)
    back = (gains.velocity + gains.integral * total) * (
        1.0 + gains.position * place
    ) + gains.derivative * slope
    loop = control.minreal(plant * back, 1e-6, verbose=False)
    return np.roots(np.polyadd(loop.num[0][0], loop.den[0][0]))


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.2, 8.0),
    st.floats(0.5, 80.0),
    st.one_of(st.just(0.0), st.floats(0.1, 60.0)),
    st.floats(0.0, 3.0),
)
def test_stability_is_that_of_the_closed_loops_poles(
    position: float, velocity: float, integral: float, derivative: float
) -> None:
    plant, truth = known_plant()
    gains = Gains(position, velocity, integral, derivative)
    largest = np.abs(closed_poles(plant, gains)).max()
    if abs(largest - 1.0) < 2e-3:
        return  # nearly on the circle either answer is right
    found = figures(Laws.of(gains), truth.responses, LoopParts.at(truth.omega, DT_S))
    assert bool(found.stable[0, 0]) == bool(largest < 1.0)


def test_margins_are_those_of_python_control() -> None:
    _, truth = known_plant()
    gains = Gains(1.43, 8.4, 1.0, 0.3)
    meant = DesignMeaning.of(gains, truth)
    found = figures(Laws.of(gains), truth.responses, LoopParts.at(truth.omega, DT_S))
    assert meant.ms[0] == pytest.approx(np.abs(1.0 / (1.0 + found.loop[0, 0])).max())
    assert meant.stable
    assert 20.0 < meant.phase_deg[0] < 90.0
    # the squared error of a step, against the step response itself
    s = control.tf([1.0, 0.0], [1.0])
    slow = Gains(0.8, 4.2)
    plant = LOOPS["longitudinal"].transfer_function()
    loop = plant * slow.velocity * slow.position / s / (1.0 + plant * slow.velocity)
    time = np.linspace(0.0, 60.0, 60_001)
    _, y = control.step_response(control.feedback(loop, 1), time)
    told = DesignMeaning.of(
        slow, replace(truth, responses=truth.responses * np.exp(2j * truth.omega * DT_S)[None])
    )
    assert told.tracking[0] == pytest.approx(np.trapezoid((1.0 - y) ** 2, time), rel=0.05)


def test_gains_keep_their_bounds_on_every_plant_and_do_better_than_random_ones() -> None:
    _, truth = known_plant()
    plants = truth.spread(Spread((0.8, 1.2), (0.0, 0.04)))
    assert len(plants.labels) == 6
    bounds = Bounds(noise=25.0, crossover_rad_s=9.0)
    found = search(plants, bounds, Box.free(plants, bounds, Gains(1, 1), with_filter=True))
    meant = figures(Laws.of(found), plants.responses, LoopParts.at(plants.omega, DT_S))
    assert meant.stable.all()
    assert meant.ms.max() <= bounds.ms * (1 + 1e-9)
    assert meant.peak.max() <= bounds.peak * (1 + 1e-9)
    assert meant.noise.max() <= bounds.noise * (1 + 1e-9)
    rng = np.random.default_rng(0)
    box = Box.free(plants, bounds, Gains(1, 1), with_filter=True)
    others = np.exp(rng.uniform(np.log(box.low.tuned()), np.log(box.high.tuned()), (300, 5)))
    costs = bounds.cost(figures(Laws(others), plants.responses, LoopParts.at(plants.omega, DT_S)))
    assert bounds.cost(meant)[0] <= costs.min()


def test_a_slow_plant_refuses_impossible_bounds() -> None:
    _, truth = known_plant()
    bounds = Bounds(ms=1.02, crossover_rad_s=9.0)
    tight = Box(Gains(3.0, 20.0), Gains(4.0, 30.0))
    with pytest.raises(DataError, match="no gains keep"):
        search(truth, bounds, tight)


STATED: dict[str, dict[str, float]] = {
    "px4": {"MPC_XY_P": 0.95, "MPC_XY_VEL_P_ACC": 1.8, "MPC_XY_VEL_I_ACC": 0.4, "MPC_XY_VEL_D_ACC": 0.2},
    "ardupilot": {"PSC_POSXY_P": 1.0, "PSC_VELXY_P": 2.0, "PSC_VELXY_I": 1.0, "PSC_VELXY_D": 0.5},
    "tum-ardrone": {"Kp_rp": 0.5, "Kd_rp": 0.35, "Ki_rp": 0.02, "agressiveness": 1.5},
    "pid": {"position": 1.4, "velocity": 4.2, "integral": 0.3, "derivative": 0.1},
}


@pytest.mark.parametrize("name", list(STATED))
def test_parameters_come_back_as_they_were(name: str) -> None:
    firmware = firmware_for(name, STATED[name], "deg", LIMIT)
    back = firmware.stated(firmware.gains(STATED[name]), STATED[name])
    assert back == {k: pytest.approx(v, rel=1e-4) for k, v in STATED[name].items() if k != "agressiveness"}


@pytest.mark.parametrize("name", list(STATED))
def test_no_parameter_moves_by_more_than_a_factor_of_two(name: str) -> None:
    _, truth = known_plant()
    bounds = Bounds(ms=1.9, peak=1.5, noise=200.0, crossover_rad_s=30.0)
    ready = ready_channel(good(), Wish(firmware=name, old=STATED[name], limit=LIMIT))
    firmware = ready.firmware
    old = STATED[name]
    present = firmware.gains(old)
    box = Box.around(present, 2.0, lambda tuned: firmware.beyond(tuned, old, 2.0 * (1 - 1e-4)))
    found = firmware.stated(search(truth, bounds, box), old)
    ratios = {k: v / old[k] for k, v in found.items()}
    assert all(0.5 <= r <= 2.0 for r in ratios.values()), ratios
    assert max(abs(np.log2(r)) for r in ratios.values()) > 0.9  # the bound is what stops it


def test_units_of_firmwares() -> None:
    px4 = firmware_for("px4", STATED["px4"], "deg", None).gains(STATED["px4"])
    assert px4.velocity == pytest.approx(1.8 / 9.80665 * 57.29578)
    assert px4.cut_hz == 5.0
    radians = firmware_for("px4", STATED["px4"], "rad", None).gains(STATED["px4"])
    assert px4.velocity / radians.velocity == pytest.approx(57.29578)
    newest = {
        k.replace("POSXY", "NE_POS").replace("VELXY", "NE_VEL"): v for k, v in STATED["ardupilot"].items()
    }
    assert firmware_for("ardupilot", newest, "deg", None).scheme.words == "ArduCopter 4.7 and later"
    assert firmware_for("ardupilot", newest, "deg", None).gains(newest).on_error == 1.0
    tum = firmware_for("tum-ardrone", {}, "deg", LIMIT).gains(SCHEMES["tum-ardrone"][0].published)
    assert tum.velocity == pytest.approx(4.2)
    assert tum.position * tum.velocity == pytest.approx(6.0)


def test_unknown_firmware_parameters_are_refused() -> None:
    older = {"MPC_XY_P": 0.95, "MPC_XY_VEL_P": 0.09, "MPC_XY_VEL_I": 0.02, "MPC_XY_VEL_D": 0.01}
    with pytest.raises(DataError, match="no known version of px4"):
        firmware_for("px4", older, "deg", None)
    with pytest.raises(UsageError, match="asks for acceleration"):
        firmware_for("px4", STATED["px4"], "m/s", None)
    with pytest.raises(UsageError, match="limit"):
        firmware_for("tum-ardrone", {}, "deg", None)
    with pytest.raises(DataError, match="lack velocity"):
        Firmware("pid", SCHEMES["pid"][0]).gains({"position": 1.0})
    with pytest.raises(DataError, match="finite"):
        Firmware("pid", SCHEMES["pid"][0]).gains({"position": 1.0, "velocity": float("nan")})
    with pytest.raises(DataError, match="no position loop"):
        firmware_for("tum-ardrone", {}, "deg", LIMIT).gains({"Kp_rp": 0.1, "Kd_rp": 0.5, "Ki_rp": 0.5})


def test_parameter_files_of_both_ground_stations(tmp_path: Path) -> None:
    file = tmp_path / "vehicle.params"
    file.write_text("# Onboard parameters\n1\t1\tMPC_XY_P\t0.95\t9\nPSC_POSXY_P,1.5\nKp_rp 0.5\n\n", "utf-8")
    assert read_parameters(file) == {"MPC_XY_P": 0.95, "PSC_POSXY_P": 1.5, "Kp_rp": 0.5}
    file.write_text("A 1\nA 2\n", "utf-8")
    with pytest.raises(DataError, match="A stands twice"):
        read_parameters(file)
    file.write_text("A one\n", "utf-8")
    with pytest.raises(DataError, match="line 1"):
        read_parameters(file)
    with pytest.raises(UsageError, match="cannot be read"):
        read_parameters(tmp_path / "none")


def test_plants_hold_models_intervals_and_the_truth() -> None:
    found = identify(good(), LIMIT)
    plants = plants_of(found.models, found.train, found.band)
    assert plants.labels[0] == "arx"
    assert len(plants.labels) == 3
    at = 2.0
    truth = LOOPS["longitudinal"].response(at)
    hold = np.exp(-0.5j * at * DT_S)
    seen = plants.responses[:, np.searchsorted(plants.omega, at)]
    assert abs(seen[0] / (truth * hold) - 1.0) < 0.1


@pytest.mark.parametrize("name", ["ts", "ts_ss"])
def test_a_model_of_rules_gives_every_rule_and_every_speed(name: str) -> None:
    fit, data = EXAMPLES[name]
    model = fit(data)
    plants = plants_of({"ts": model}, data, (0.1, 10.0))
    rules = len(model.rules())
    assert rules > 1
    told = [*plants.labels, *plants.dropped]
    assert sum("rule" in label for label in told) == rules
    assert any(" at y = " in label for label in told)
    fast = plants.responses[:, -1]
    assert np.isfinite(plants.responses).all()
    assert np.abs(fast).max() < np.abs(plants.responses).max()


def _flown(size: float, **known: object) -> Callable[[], HeldOut]:
    def made() -> HeldOut:
        rng = np.random.default_rng(5)
        inputs = [steps(rng, size) for _ in range(8)]
        return channel([(u, answer(u, rng)) for u in inputs], **known)  # type: ignore[arg-type]

    return made


def _noise_alone() -> HeldOut:
    rng = np.random.default_rng(6)
    inputs = [steps(rng, 5.0) for _ in range(8)]
    return channel([(u, 0.3 * rng.standard_normal((len(u), 1))) for u in inputs])


def _full_tilt() -> HeldOut:
    rng = np.random.default_rng(7)
    inputs = [np.clip(steps(rng, 40.0), -LIMIT, LIMIT) for _ in range(8)]
    return channel([(u, answer(u, rng)) for u in inputs])


def _sensor_at_its_limit() -> HeldOut:
    rng = np.random.default_rng(8)
    inputs = [steps(rng, 10.0) for _ in range(8)]
    return channel([(u, np.clip(answer(u, rng), -0.2, 0.2)) for u in inputs])


REFUSED: dict[str, tuple[Callable[[], HeldOut], str]] = {
    "another unit": (_flown(8.0, units=("deg", "deg/s")), "position loop goes round a velocity"),
    "quiet input": (
        _flown(8.0, doubts=(Doubt("quiet", "input theta_in moves by 0.01 deg rms only", "fly steps"),)),
        "moves by 0.01",
    ),
    "narrow input": (_flown(8.0, doubts=(Doubt("narrow", "one frequency alone", "sweep"),)), "one frequency"),
    "closed loop": (_flown(8.0, loops=("the input answers v_x",)), "answers v_x"),
    "noise alone": (_noise_alone, "coheres|not shown to be better"),
    "full tilt": (_full_tilt, "at its limit of 12"),
    "sensor at its limit": (_sensor_at_its_limit, "extremes"),
}


@pytest.mark.parametrize("case", list(REFUSED))
def test_flights_that_do_not_identify_are_refused_with_what_to_fly(case: str) -> None:
    made, words = REFUSED[case]
    with pytest.raises(DataError, match=words) as refused:
        identify(made(), LIMIT)
    assert refused.value.hint


@pytest.mark.parametrize(("drift", "accepted"), [(0.02, True), (0.2, False)])
def test_few_flights_are_enough_where_the_response_is_known(drift: float, accepted: bool) -> None:
    """Six minutes of a clean sweep in two flights: no verdict on free runs, but the response to a tenth."""
    rng = np.random.default_rng(1)
    u = chirp(np.arange(9000) * DT_S, (0.1, 3.0), 4.0)[:, None]
    parts = []
    for _ in range(2):
        slow = lfilter([1.0], [1.0, -0.9995], rng.standard_normal(len(u)))
        parts.append((u, answer(u, rng) + drift * (slow / slow.std())[:, None]))
    item = channel(parts)
    if accepted:
        assert identify(item, LIMIT).band[1] > 10.0
    else:
        with pytest.raises(DataError, match=r"follows the response measured there in \d+ % of the band"):
            identify(item, LIMIT)


def test_remarks_do_not_refuse() -> None:
    item = _flown(8.0, doubts=(Doubt("band", "v_x follows theta_in from 0.05 to 1.2 Hz", ""),))()
    assert identify(item, LIMIT).band[1] > 3.0


def test_a_model_without_an_interval_alone_is_refused() -> None:
    item = good()
    arx = item.models["arx"]
    blind = replace(arx, covariance=np.full_like(arx.covariance, np.nan))  # type: ignore[type-var, attr-defined]
    with pytest.raises(DataError, match="no model states an interval"):
        identify(replace(item, models={**item.models, "arx": blind}), LIMIT)


def test_a_present_loop_faster_than_the_flights_is_refused() -> None:
    wish = Wish(old={"position": 30.0, "velocity": 400.0}, limit=LIMIT)
    with pytest.raises(DataError, match="have no information above") as refused:
        _design([ready_channel(good(), wish)], wish)
    assert "sweep" in str(refused.value.hint)


def test_a_design_stands_beside_the_present_gains_and_is_stored_without_loss(tmp_path: Path) -> None:
    wish = Wish(old=PUBLISHED, limit=LIMIT)
    ready = ready_channel(good(), wish)
    axes = _design([ready], wish)
    design = Design("run", ("pid", "words"), tuple(axes), {}, PUBLISHED, _new([ready], axes, wish))
    axis = axes[0]
    assert list(axis.laws) == ["present", "present_x2", "next", "goal"]
    assert axis.laws["next"].integral == 0.0  # of nothing two times is nothing
    assert axis.meanings["goal"].ms[1] <= 1.6 * (1 + 1e-9)
    assert axis.meanings["goal"].tracking[1] < axis.meanings["present"].tracking[1]
    files = design.files()
    assert all(" ".join(SAFETY.split()[:6]) in text for text in files.values())
    for name, text in files.items():
        (tmp_path / name).write_text(text, "utf-8")
    assert read_parameters(tmp_path / "old.param") == PUBLISHED
    assert read_parameters(tmp_path / "new.param") == design.new
    again = open_design(tmp_path)[0]
    assert again.laws == axis.laws
    assert again.meanings == axis.meanings
    body = json.loads(files["design.json"])
    (tmp_path / "design.json").write_text(json.dumps(body | {"axes": [{}]}), "utf-8")
    with pytest.raises(StoreError, match="damaged"):
        open_design(tmp_path)


def test_without_present_gains_no_parameters_are_written() -> None:
    wish = Wish(limit=LIMIT)
    ready = ready_channel(good(), wish)
    axes = _design([ready], wish)
    files = Design("run", ("pid", "words"), tuple(axes)).files()
    assert list(files) == ["design.json"]
    assert list(axes[0].laws) == ["goal"]


def test_a_plant_that_falls_as_the_input_rises_is_turned_round() -> None:
    wish = Wish(limit=LIMIT)
    up = ready_channel(good(), wish)
    down = ready_channel(good(gain=-1.0), wish)
    assert (up.sign, down.sign) == (1.0, -1.0)
    assert _design([down], wish)[0].laws["goal"].velocity > 0.0


def test_feedforward_follows_a_slow_reference_better() -> None:
    _, truth = known_plant()
    plain = Gains(1.43, 8.4)
    led = with_feedforward(plain, truth)
    steady = abs(truth.responses[0, 0])
    assert led.feedforward == pytest.approx(1.0 / steady, rel=0.5)
