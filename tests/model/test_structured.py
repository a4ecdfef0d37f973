"""Structured state space: derivatives by name, against plants whose truth is known."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.errors import DataError, UsageError
from flysid.ingest.synth.manoeuvres import chirp
from flysid.model.structured.fitted_structured import FittedStructured
from flysid.model.structured.held_input import held, whole_samples
from flysid.model.structured.joint_fit import JointProblem, Response, response_of
from flysid.model.structured.plan_file import Plan
from flysid.model.structured.structured_state_space import StructuredStateSpace
from flysid.validate.compare_models import compare

DT_S = 0.02
TRUE = {"Z_w": -1.2, "Z_q": 15.0, "M_w": -0.15, "M_q": -1.8, "Z_e": -9.0, "M_e": -6.0, "late": 0.046}
SHORT_PERIOD = """
states = ["w", "q"]
[F.w]
w = "Z_w"
q = "Z_q"
[F.q]
w = "M_w"
q = "M_q"
[G.w]
elevator = "Z_e"
[G.q]
elevator = "M_e"
[delay]
elevator = { name = "late", start = 0.02 }
"""


def matrices() -> dict[str, FloatArray]:
    t = TRUE
    return {
        "F": np.array([[t["Z_w"], t["Z_q"]], [t["M_w"], t["M_q"]]]),
        "G": np.array([[t["Z_e"]], [t["M_e"]]]),
        "H": np.eye(2),
        "D": np.zeros((2, 1)),
        "delay": np.array([[t["late"]]]),
    }


@cache
def flights(count: int = 3, seed: int = 1) -> Dataset:
    """The short period under sweeps, the input 46 ms late; simulated ten times finer than it is recorded."""
    rng = np.random.default_rng(seed)
    n = 2000
    fine = 10
    joint = np.zeros((3, 3))
    joint[:2, :2] = matrices()["F"]
    joint[:2, 2:] = matrices()["G"]
    step = expm(joint * DT_S / fine)
    us = []
    ys = []
    for _ in range(count):
        u = chirp(np.arange(n) * DT_S, (0.05, 3.0), 0.1) + 0.01 * rng.standard_normal(n)
        sent = np.repeat(u, fine)
        late = round(TRUE["late"] / DT_S * fine)
        x = np.zeros((n * fine, 2))
        for k in range(n * fine - 1):
            x[k + 1] = step[:2, :2] @ x[k] + step[:2, 2] * (sent[k - late] if k >= late else 0.0)
        us.append(u[:, None])
        ys.append(x[::fine] + [1.0, 0.2] + rng.standard_normal((n, 2)) * [0.05, 0.005])
    return Dataset.from_arrays(
        us, ys, DT_S, inputs=[Signal("elevator", "rad")], outputs=[Signal("w", "m/s"), Signal("q", "rad/s")]
    )


@cache
def fitted() -> FittedStructured:
    return StructuredStateSpace(Plan.parse(SHORT_PERIOD)).fit(flights())


def test_every_derivative_is_found_with_its_unit_and_an_interval_that_holds() -> None:
    model = fitted()
    for name, true in TRUE.items():
        term = model.derivative(name)
        assert not term.dropped
        assert abs(term.value / true - 1.0) < 0.1, str(term)
        assert abs(term.value - true) < 4.0 * term.error
        assert 0.0 < term.insensitivity <= term.error * (1.0 + 1e-9)
    assert model.derivative("Z_q").unit == "m/s/s per rad/s"
    assert model.derivative("M_q").unit == "1/s"
    assert model.derivative("late").unit == "s"
    true_modes = np.linalg.eigvals(matrices()["F"])
    apart = np.abs(np.sort_complex(model.eigenvalues) - np.sort_complex(true_modes))
    assert apart.max() < 0.05 * np.abs(true_modes).max()
    assert "Z_w = -1." in str(model)


def test_a_free_run_on_flights_it_has_not_seen_leaves_the_noise() -> None:
    held_out = flights(1, seed=9)
    segment = held_out.segments[0]
    errors = fitted().free_run(segment) - segment.y
    rms = np.sqrt(np.nanmean(errors[100:] ** 2, axis=0))
    assert (rms < [0.075, 0.0075]).all()
    compared = compare({"structured": fitted()}, held_out, train=flights())
    assert "structured" in compared.entries[0].models


def test_the_frequency_response_is_that_of_the_sampled_plant() -> None:
    omega = np.array([0.5, 2.0, 8.0])
    delay = matrices()["delay"]
    exact = held(matrices(), DT_S, "zero", (0,), whole_samples(delay[0], DT_S)).response(omega, DT_S)
    found = fitted().frequency_response(omega)
    assert np.abs(found.response / exact - 1.0).max() < 0.06
    assert (found.magnitude_error > 0.0).all()
    low, high = fitted().simulation_band(flights().segments[0].u, draws=10)
    assert (high >= low).all()


@pytest.mark.parametrize("hold", ["zero", "first"])
@pytest.mark.parametrize("delay_s", [0.0, 0.008, 0.02, 0.047])
def test_a_held_input_late_by_part_of_a_sample_is_sampled_exactly(hold: str, delay_s: float) -> None:
    """Against the system on a grid twenty times as fine, on which every delay is whole."""
    fine = 20
    m = {**matrices(), "D": np.array([[0.3], [0.0]]), "delay": np.array([[delay_s]])}
    late = whole_samples(m["delay"][0], DT_S)
    system = held(m, DT_S, hold, (0,) if delay_s else (), late)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    u = np.append(np.zeros(5), rng.standard_normal(40))
    times = np.arange(len(u) * fine) / fine
    dense = np.repeat(u, fine) if hold == "zero" else np.interp(times, np.arange(len(u)), u)
    shift = round(delay_s / DT_S * fine)
    dense = np.append(np.zeros(shift), dense)[: len(times)]
    tiny = held({**m, "delay": np.zeros((1, 1))}, DT_S / fine, hold, (), (0,))  # type: ignore[arg-type]
    slow = _run(system, np.append(np.zeros(late[0]), u)[: len(u)])
    fast = _run(tiny, dense)[::fine]
    assert np.abs(slow - fast).max() < 1e-9


def _run(system: object, u: FloatArray) -> FloatArray:
    a, b, c, d = (getattr(system, name) for name in "abcd")
    x = np.zeros(len(a))
    out = np.empty((len(u), len(c)))
    for k, value in enumerate(u):
        out[k] = c @ x + d[:, 0] * value
        x = a @ x + b[:, 0] * value
    return out


def test_derivatives_of_the_cost_are_exact() -> None:
    plan = Plan.parse(
        SHORT_PERIOD + '[H.a]\nw = { tied = "Z_w", factor = 2 }\nq = { name = "arm", start = 0.4 }\n'
        '[D.a]\nelevator = { tied = "Z_e" }\n'
    )
    layout = plan.layout([Signal("elevator")], [Signal("w"), Signal("q"), Signal("a")])
    omega = np.geomspace(0.5, 20.0, 7)
    theta = np.array([*TRUE.values(), 0.4])
    g = response_of(layout.matrices(theta), omega)
    ones = np.ones(len(omega))
    responses = tuple(
        Response(i, 0, omega, 1.1 * g[:, i, 0], 0.1 * ones, ones, np.eye(len(omega))) for i in range(3)
    )
    problem = JointProblem(layout, responses, DT_S, "none")
    _, jacobian = problem.residuals(theta)
    for k in range(len(theta)):
        step = np.zeros(len(theta))
        step[k] = 1e-6 * abs(theta[k])
        numeric = (problem.residuals(theta + step)[0] - problem.residuals(theta - step)[0]) / (2 * step[k])
        assert np.allclose(jacobian[:, k], numeric, rtol=1e-5, atol=1e-6 * np.abs(jacobian[:, k]).max())


def test_terms_that_the_vehicle_does_not_have_are_dropped_and_no_others() -> None:
    """A lagged elevator in w that is not there; without pruning it stays."""
    text = SHORT_PERIOD.replace("[F.w]\n", '[F.w]\nlag = { name = "Z_lag", start = 0.0 }\n')
    for name in ("Z_w", "Z_q", "Z_e"):
        text = text.replace(f'"{name}"', f'{{ name = "{name}", start = {0.7 * TRUE[name]} }}')
    text = text.replace('states = ["w", "q"]', 'states = ["w", "q", "lag"]')
    text += "[F.lag]\nlag = -5.0\n[G.lag]\nelevator = 5.0\n"
    model = StructuredStateSpace(Plan.parse(text)).fit(flights())
    assert [d.name for d in model.derivatives if d.dropped] == ["Z_lag"]
    assert "J rises by" in model.derivative("Z_lag").dropped
    assert model.n_parameters == len(TRUE)
    kept = StructuredStateSpace(Plan.parse(text), prune=False).fit(flights())
    assert not kept.derivative("Z_lag").dropped


def test_without_a_file_every_output_is_a_state() -> None:
    model = StructuredStateSpace().fit(flights())
    assert model.state_names == ("w", "q")
    assert abs(model.derivative("q per elevator").value / TRUE["M_e"] - 1.0) < 0.1


def test_through_a_reference_the_plant_in_a_loop_is_found() -> None:
    """An unstable rate loop; the input answers the output, and a disturbance acts."""
    rng = np.random.default_rng(3)
    n = 4000
    chirps = chirp(np.arange(n) * DT_S, (0.05, 4.0), 1.0)
    x = 0.0
    gust = 0.0
    u = np.empty(n)
    y = np.empty(n)
    keep = np.exp(0.8 * DT_S)
    for k in range(n):
        gust = 0.95 * gust + 0.02 * rng.standard_normal()
        y[k] = x + gust
        u[k] = chirps[k] - 1.5 * y[k]
        x = keep * x + 4.0 * (keep - 1.0) / 0.8 * u[k]
    data = Dataset.from_arrays(
        np.column_stack([u, chirps]), y, DT_S, inputs=[Signal("u"), Signal("chirp")], outputs=[Signal("p")]
    )
    plan = Plan.parse('states = ["p"]\n[F.p]\np = "L_p"\n[G.p]\nu = "L_u"\n')
    model = StructuredStateSpace(plan, reference=["chirp"]).fit(data)
    assert abs(model.derivative("L_p").value - 0.8) < 0.3
    assert abs(model.derivative("L_u").value / 4.0 - 1.0) < 0.05
    assert [s.name for s in model.inputs] == ["u", "chirp"]
    assert not model.realisation.b[:, 1].any()
    assert not model.is_stable


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('w = "Z_w"', 'x = "Z_w"'), "no state is called 'x'"),
        (('elevator = "Z_e"', 'rudder = "Z_e"'), "no input is called 'rudder'"),
        (('w = "Z_w"', 'w = { tied = "Z_x" }'), "tied to 'Z_x', which is no term"),
        (('w = "Z_w"', "w = { value = 3 }"), "F.w.w is"),
        (('w = "Z_w"', 'w = { name = "Z_w", start = "low" }'), "'low' is no number"),
        (('states = ["w", "q"]', "states = []"), "needs its states"),
        (('states = ["w", "q"]', 'states = ["w", "q"]\ntitle = "x"'), "no entry 'title'"),
        (("[F.w]", "[H.climb]\nw = 1\n[F.w]"), "no output is called 'climb'"),
        (('{ name = "late", start = 0.02 }', "-0.1"), "a delay is at least 0 s"),
        (
            ('{ name = "late", start = 0.02 }', '{ tied = "M_e", factor = -1 }'),
            "-1 times a delay",
        ),
        (("[F.w]", "[F.w"), "not TOML"),
        (("[F.w]", '[units]\nx = "m"\n[F.w]'), "[units]: no state is called 'x'"),
    ],
)
def test_a_file_that_cannot_be_is_refused_with_the_place(
    change: tuple[str, str], words: str, tmp_path: Path
) -> None:
    path = tmp_path / "model.toml"
    path.write_text(SHORT_PERIOD.replace(*change))
    with pytest.raises(UsageError) as caught:
        StructuredStateSpace(path).fit(flights())
    assert words in str(caught.value)
    assert caught.value.path == str(path)


def test_an_output_without_a_row_is_named() -> None:
    plan = Plan.parse('states = ["w"]\n[F.w]\nw = "Z_w"\n[G.w]\nelevator = "Z_e"\n')
    with pytest.raises(UsageError, match="output 'q' is no state"):
        StructuredStateSpace(plan).fit(flights())


def test_terms_that_only_show_together_are_named() -> None:
    text = SHORT_PERIOD + '[F.servo]\nservo = "servo"\n[G.servo]\nelevator = { name = "s_e", start = 5 }\n'
    text = text.replace('["w", "q"]', '["w", "q", "servo"]').replace('servo = "servo"', "servo = -20.0")
    text = text.replace('[G.q]\nelevator = "M_e"\n', "").replace(
        "[F.q]\n", '[F.q]\nservo = { name = "M_s", start = -6 }\n'
    )
    with pytest.raises(DataError, match="cannot tell M_s, s_e apart"):
        StructuredStateSpace(Plan.parse(text)).fit(flights())


def test_a_term_of_a_hidden_state_needs_a_start() -> None:
    text = SHORT_PERIOD.replace('["w", "q"]', '["w", "q", "servo"]')
    text += "[F.servo]\nservo = -20.0\n[G.servo]\nelevator = 20.0\n"
    text = text.replace("[F.q]\n", '[F.q]\nservo = "M_s"\n')
    with pytest.raises(UsageError, match=r"no start for .*M_s"):
        StructuredStateSpace(Plan.parse(text)).fit(flights())


def test_terms_that_no_response_shows_are_dropped_or_refused() -> None:
    text = SHORT_PERIOD.replace('["w", "q"]', '["w", "q", "x"]') + '[F.x]\nw = { name = "X_w", start = 1 }\n'
    model = StructuredStateSpace(Plan.parse(text)).fit(flights())
    assert "no response" in model.derivative("X_w").dropped
    with pytest.raises(DataError, match="no measured response shows X_w"):
        StructuredStateSpace(Plan.parse(text), prune=False).fit(flights())


def test_a_delay_below_zero_is_dropped() -> None:
    """The record has the input three samples later than the vehicle."""
    rng = np.random.default_rng(5)
    u = chirp(np.arange(3000) * DT_S, (0.05, 3.0), 1.0)
    y = np.zeros(len(u))
    keep = np.exp(-2.0 * DT_S)
    for k in range(len(u) - 1):
        y[k + 1] = keep * y[k] + (1.0 - keep) * u[k]
    y += 0.01 * rng.standard_normal(len(y))
    data = Dataset.from_arrays(u[:-3], y[3:], DT_S, inputs=[Signal("u")], outputs=[Signal("p")])
    text = 'states = ["p"]\n[F.p]\np = "L_p"\n[G.p]\nu = { tied = "L_p", factor = -1 }\n[delay]\nu = "tau"\n'
    model = StructuredStateSpace(Plan.parse(text)).fit(data)
    assert "there is none" in model.derivative("tau").dropped
    alone = 'states = ["p"]\n[F.p]\np = -2.0\n[G.p]\nu = 2.0\n[delay]\nu = "tau"\n'
    with pytest.raises(DataError, match="the only free term is tau"):
        StructuredStateSpace(Plan.parse(alone)).fit(data)


def test_an_input_without_coherence_is_refused_with_what_to_fly() -> None:
    rng = np.random.default_rng(0)
    quiet = Dataset.from_arrays(rng.standard_normal((800, 1)), rng.standard_normal((800, 1)), DT_S)
    with pytest.raises(DataError, match="too few frequencies"):
        StructuredStateSpace().fit(quiet)


def test_an_input_without_delay_needs_no_state_of_its_own() -> None:
    punctual = StructuredStateSpace(Plan.parse(SHORT_PERIOD.partition("[delay]")[0])).fit(flights())
    assert len(punctual.realisation.a) == 2
    assert len(fitted().realisation.a) == 3  # the elevator, late by a part of a sample
