"""Model predictive control on the exported CasADi model: a figure of eight in RotorPy, beside other numbers.

`python -m bench.rotorpy_mpc [vehicles] [first seed]`: the hidden vehicles of `bench.rotorpy_vehicles`. One
flight of 20 s of each is logged and fitted. The controller is one and the same, and so is the source of its
model: what `flysid export VEHICLE --to casadi` writes. Only the numbers differ: those fitted, the true ones,
and nominal ones, which are the middle of what vehicles are drawn from at the mass that a scale shows.
"Corrected" adds to each model the accelerations that it missed of late, as a controller in use does.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

import flysid
from bench.rotorpy_vehicles import FLIGHT_S, SPEED_MAX, dataset, draw, fly, truth, vehicle_of
from flysid.dataset import FloatArray
from flysid.export.vehicles.body import hover_share
from flysid.export.vehicles.portable import portable_source
from flysid.sixdof import layout
from flysid.sixdof.fitted import FittedVehicle

STEP_S = 0.02
BLOCKS = np.repeat(np.arange(10), [1, 1, 1, 2, 2, 3, 4, 5, 5, 6])
"""Which move holds at each step of the horizon."""
EIGHT_M = np.array([2.0, 1.0])
PACE = 1.2
"""rad/s of the longer side; the shorter has twice as many."""
RAMP_S = 1.0
EIGHT_S = 10.0
FROM_S = 2.0
"""Errors count from here, when the figure is entered."""
MOVE = 0.2
"""A share of full command, away from hover, which costs as much as one of these:"""
WEIGHTS = 1.0 / np.repeat([0.05, 0.5, 0.05, 4.0], [3, 3, 1, 3])
"""position off by so many m, velocity m/s, the quaternion's z, body rate rad/s;"""
SEEN = [0, 1, 2, 3, 4, 5, 9, 10, 11, 12]
"""their places in the state."""
FORCED = [3, 4, 5, 10, 11, 12]
"""Places of what accelerations change."""
REMEMBERED = 0.9
"""Share of a missed acceleration that the corrected model keeps from step to step."""
GOAL = 0.3


class Middle:
    """Draws the middle of every range."""

    def uniform(self, low: float, high: float, /) -> float:
        """Half way from `low` to `high`."""
        return 0.5 * (low + high)


def vehicle_with(parameters: Mapping[str, Any]) -> FittedVehicle:
    """A vehicle with these numbers of RotorPy's, as if a fit had found them."""
    motors = int(parameters["num_rotors"])
    places = {number.name: number.index for number in layout.numbers(motors)}
    theta = np.zeros(layout.count(motors))
    for name, value in truth(parameters).items():
        theta[places[name]] = value
    theta[layout.POWER] = 1.0
    theta[layout.ARM] = parameters["Ixx"] / (parameters["k_eta"] * SPEED_MAX**2)
    return FittedVehicle(
        theta=theta,
        covariance=np.zeros((len(theta), len(theta))),
        inside=np.zeros(len(theta), dtype=bool),
        held={},
        zero=0.0,
        full=SPEED_MAX,
        reference_v=float("nan"),
        dt_s=STEP_S,
        method="stated",
        flights=(),
    )


def eight(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, 3) position and velocity at times of a figure of eight that begins at rest."""
    gone = PACE * (t - RAMP_S * (1.0 - np.exp(-t / RAMP_S)))
    pace = PACE * (1.0 - np.exp(-t / RAMP_S))
    angles = gone[:, None] * [1.0, 2.0]
    position = np.column_stack([EIGHT_M * np.sin(angles), np.full(len(t), 2.0)])
    velocity = np.column_stack([EIGHT_M * [1.0, 2.0] * np.cos(angles) * pace[:, None], np.zeros(len(t))])
    return position, velocity


class Controller:
    """One Gauss-Newton step of a bounded least-squares problem every sample, from the last sample's moves."""

    def __init__(self, vehicle: FittedVehicle, corrected: bool) -> None:
        import casadi

        module: dict[str, Any] = {}
        exec(portable_source(vehicle), module)
        plain = module["casadi_function"](STEP_S)
        self.states, self.motors = plain.numel_in(0), plain.numel_in(1)
        x, u = casadi.SX.sym("x", self.states), casadi.SX.sym("u", self.motors)
        missed = casadi.SX.sym("missed", 6)
        more = casadi.SX.zeros(self.states)
        more[FORCED] = missed * STEP_S
        after = plain(x, u) + more
        ahead = len(BLOCKS)
        self.step = casadi.Function("step", [x, u, missed], [after])
        self.path = self.step.mapaccum(ahead)
        slopes = [casadi.densify(casadi.jacobian(after, by)) for by in (x, u)]
        self.slopes = casadi.Function("slopes", [x, u, missed], slopes).map(ahead)
        self.hover = float(np.sqrt(hover_share(vehicle)))
        self.moves = np.full((BLOCKS[-1] + 1, self.motors), self.hover)
        self.memory = np.full(self.motors, self.hover)
        self.missed = np.zeros(6)
        self.keep = REMEMBERED if corrected else 1.0
        self.expected: FloatArray | None = None

    def command(self, t: float, measured: FloatArray) -> FloatArray:
        """(motors,) shares of full command at time `t`, from the (13,) measured state."""
        from scipy.optimize import lsq_linear

        if self.expected is not None:
            off = (measured - self.expected)[FORCED] / STEP_S
            self.missed += (1.0 - self.keep) * off
        ahead = len(BLOCKS)
        x = np.concatenate([measured, self.memory])
        given = self.moves[BLOCKS].T
        path = np.asarray(self.path(x, given, np.tile(self.missed[:, None], ahead)))
        before = np.column_stack([x, path[:, :-1]])
        by_x, by_u = self.slopes(before, given, np.tile(self.missed[:, None], ahead))
        by_x = np.asarray(by_x).reshape(self.states, ahead, self.states)
        by_u = np.asarray(by_u).reshape(self.states, ahead, self.motors)
        times = np.asarray(t + STEP_S * np.arange(1, ahead + 1), dtype=np.float64)
        wanted = np.hstack([*eight(times), np.zeros((ahead, 4))])
        left = (path.T[:, SEEN] - wanted) * WEIGHTS
        grown = np.zeros((self.states, self.moves.size))
        slopes = []
        for k, block in enumerate(BLOCKS):
            grown = by_x[:, k] @ grown
            grown[:, block * self.motors : (block + 1) * self.motors] += by_u[:, k]
            slopes.append(grown[SEEN] * WEIGHTS[:, None])
        flat = self.moves.ravel()
        rows = np.vstack([*slopes, np.eye(flat.size) / MOVE])
        sides = np.concatenate([left.ravel(), (flat - self.hover) / MOVE])
        upper = np.linalg.cholesky(rows.T @ rows).T
        side = np.linalg.solve(upper.T, -rows.T @ sides)
        change = lsq_linear(upper, side, (-flat - 1e-9, 1.0 - flat + 1e-9), method="bvls").x
        self.moves = np.clip(flat + change, 0.0, 1.0).reshape(self.moves.shape)
        first: FloatArray = self.moves[0]
        after = np.asarray(self.step(x, first, self.missed)).ravel()
        self.expected = after[:13]
        self.memory = after[13:]
        return first


def tracked_m(parameters: Mapping[str, Any], controller: Controller) -> float:
    """Root mean square of metres from the figure, flown in RotorPy; infinite where it is lost."""
    vehicle = vehicle_of(parameters)
    state = vehicle.initial_state
    times = np.asarray(STEP_S * np.arange(round(EIGHT_S / STEP_S)), dtype=np.float64)
    wanted, _ = eight(times)
    apart = []
    for t, goal in zip(times, wanted, strict=True):
        measured = np.concatenate([state["x"], state["v"], state["q"][[3, 0, 1, 2]], state["w"]])
        apart.append(float(np.linalg.norm(state["x"] - goal)))
        if not apart[-1] < np.linalg.norm(EIGHT_M):
            return float("inf")
        given = controller.command(t, measured)
        state = vehicle.step(state, {"cmd_motor_speeds": SPEED_MAX * given}, STEP_S)
    return float(np.sqrt(np.mean(np.square(apart)[times >= FROM_S])))


def main(vehicles: int, first_seed: int) -> None:
    """Print a line a vehicle, and what the fitted numbers save."""
    saved: dict[str, list[float]] = {"as they are": [], "corrected": []}
    for seed in range(first_seed, first_seed + vehicles):
        began = time.process_time()
        rng = np.random.default_rng(seed)
        parameters = draw(rng)
        data = dataset([fly(parameters, FLIGHT_S, rng)], rng)
        models = {
            "nominal": vehicle_with(draw(Middle(), parameters["mass"])),
            "fitted": flysid.Vehicle(zero=0.0, full=SPEED_MAX, calm=True).fit(data),
            "true": vehicle_with(parameters),
        }
        words = []
        for kind, shares in saved.items():
            errors = {
                name: tracked_m(parameters, Controller(model, kind == "corrected"))
                for name, model in models.items()
            }
            lost = np.isinf(errors["fitted"])
            shares.append(-np.inf if lost else 1.0 - errors["fitted"] / errors["nominal"])
            words.append(f"{kind}: " + ", ".join(f"{name} {100.0 * m:.2f} cm" for name, m in errors.items()))
        print(f"{seed}: {'; '.join(words)}; CPU {time.process_time() - began:.0f} s", flush=True)
    for kind, shares in saved.items():
        met = sum(share >= GOAL for share in shares)
        print(
            f"{kind}: error less by {100.0 * np.median(shares):.0f} % in the median, "
            f"{100.0 * np.min(shares):.0f} % at least; {100.0 * GOAL:.0f} % or more on {met} of {len(shares)}"
        )


if __name__ == "__main__":
    try:
        import casadi  # noqa: F401
        import rotorpy  # noqa: F401
    except ModuleNotFoundError as error:
        print(f"{error.name} is not installed: skipped")
        sys.exit(0)
    numbers = [int(word) for word in sys.argv[1:]]
    main(*(numbers + [20, 0][len(numbers) :]))
