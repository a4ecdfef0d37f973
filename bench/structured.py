"""Stability and control derivatives of the simulated vehicle in hover, whose truth its linearisation knows.

`python -m bench.structured [runs] [first seed] [plain|all]`: three multisines of 180 s, one an axis, flown in
light turbulence by the vehicle's own inner loop, 50 rows a second; noise of 0.02 m/s, 0.1 deg, 0.5 deg/s.
The model of docs/hover.toml, from what the loop asks of the rotors to seven outputs, with two planted terms
that the vehicle does not have (M_u, L_p). "plain" leaves quadratic drag and the battery out, which no
linear model has; "all" has every effect.

Printed: median and worst errors of derivatives and eigenvalues, how often they are within 10 and 5 %, how
often 95 % intervals hold, how often planted terms were dropped, and true ones.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from flysid.dataset import Dataset, FloatArray, Signal
from flysid.ingest.synth.dryden import Wind, wind_field
from flysid.ingest.synth.plants import LOOPS
from flysid.ingest.synth.rigid_body import ALL, Effects, SimulatedVehicle, fly_vehicle
from flysid.ingest.synth.tuning import linearise
from flysid.model.polynomials import ComplexArray
from flysid.model.structured.fitted_structured import FittedStructured
from flysid.model.structured.joint_fit import IntArray
from flysid.model.structured.plan_file import Plan
from flysid.model.structured.structured_state_space import StructuredStateSpace

FILE = Path("docs/hover.toml")
STEP_S = 0.0005
"""Of commands and integration."""
DT_S = 0.02
SECONDS = 180.0
SETTLED_S = 60.0
"""Of the same multisine, flown before: nine time constants of the slowest mode."""
BAND_HZ = (0.05, 8.0)
BAND_RAD_S = (0.8, 50.0)
PEAKS = (3.0, 3.0, 0.69)
"""Of theta_in, phi_in (deg), vz_in (m/s)."""
CLIPS = 300
FINE_HZ = 64.0
"""Eight samples of the fastest harmonic, on which its peaks show."""
WIND_M_S = 0.25
INPUTS = (("pitch_effort", ""), ("roll_effort", ""), ("throttle", ""), ("theta_in", "deg"), ("phi_in", "deg"),
          ("vz_in", "m/s"))  # fmt: skip
OUTPUTS = (("vx", "m/s", 0.02), ("vy", "m/s", 0.02), ("vz", "m/s", 0.02), ("theta", "deg", 0.1),
           ("phi", "deg", 0.1), ("q", "deg/s", 0.5), ("p", "deg/s", 0.5))  # fmt: skip
PLAIN = replace(ALL, quadratic_drag=False, battery_sag=False, delay=False)
PLANTED = ("M_u", "L_p")


def flown(seed: int, effects: Effects = PLAIN) -> Dataset:
    """Three flights, a multisine on one axis each, one period in its steady state."""
    vehicle = SimulatedVehicle(effects=effects)
    rng = np.random.default_rng(seed)
    rows = round(SECONDS / DT_S)
    each = round(DT_S / STEP_S)
    us = []
    ys = []
    for axis, peak in enumerate(PEAKS):
        commands = np.zeros((round((SETTLED_S + SECONDS) / STEP_S), 3))
        commands[:, axis] = peak * multisine(rng)
        air = wind_field(Wind(WIND_M_S), len(commands) // each, DT_S, 20.0, rng)
        wind = np.repeat(air, each, axis=0)
        flight = fly_vehicle(
            vehicle, commands, period_s=STEP_S, record_s=DT_S, wind_m_s=wind, step_s=STEP_S
        ).series()
        asked = commands[::each]
        told = np.column_stack([flight[name] for name, _ in INPUTS[:3]]) - jumps(vehicle, commands) / 2.0
        us.append(np.column_stack([told, asked])[-rows:])
        noise = [size * rng.standard_normal(len(asked)) for *_, size in OUTPUTS]
        ys.append((np.column_stack([flight[name] for name, *_ in OUTPUTS]) + np.column_stack(noise))[-rows:])
    inputs = [Signal(name, unit) for name, unit in INPUTS]
    outputs = [Signal(name, unit) for name, unit, _ in OUTPUTS]
    return Dataset.from_arrays(us, ys, DT_S, inputs=inputs, outputs=outputs)


def multisine(rng: np.random.Generator) -> FloatArray:
    """One period of all harmonics inside the band, its end before it, the slower the larger, peak 1.

    Phases start at random. The signal is clipped, and its spectrum keeps the phases and gets its sizes back,
    time and again, so that the peak comes down to 1.2 times the rms (3.6 at random: a ninth of the power);
    van der Ouderaa, Schoukens and Renneboog, IEEE Trans. Instrum. Meas. 37 (1988).
    """
    first, last = (round(f * SECONDS) for f in BAND_HZ)
    harmonics = np.arange(first, last + 1)
    lines = np.exp(2j * np.pi * rng.random(len(harmonics))) / harmonics
    for share in np.linspace(0.8, 0.95, CLIPS):
        x = _period(lines, harmonics, FINE_HZ)
        top = share * np.abs(x).max()
        turned = np.fft.rfft(np.clip(x, -top, top))[harmonics]
        lines = turned / (np.abs(turned) * harmonics)
    period = _period(lines, harmonics, 1.0 / STEP_S)
    twice = np.concatenate([period[-round(SETTLED_S / STEP_S) :], period])
    return np.asarray(twice / np.abs(period).max())


def _period(lines: ComplexArray, harmonics: IntArray, rate_hz: float) -> FloatArray:
    spectrum = np.zeros(round(SECONDS * rate_hz) // 2 + 1, dtype=np.complex128)
    spectrum[harmonics] = lines
    return np.asarray(np.fft.irfft(spectrum))


def jumps(vehicle: SimulatedVehicle, commands: FloatArray) -> FloatArray:
    """(N, 3) by how much the efforts jump where a command does, at the rows of the record.

    Between two commands the loop lets go of what the first lag has done, so that the rotors are told a
    sawtooth; a record takes its top, the motors answer its middle.
    """
    loop = vehicle.loop
    right = truth(vehicle.effects)
    damping = 2.0 * loop.attitude_damping * loop.attitude_rad_s
    pitch = damping * loop.pitch.gain / loop.pitch.lag_s / right["M_e"]
    roll = damping * loop.roll.gain / loop.roll.lag_s / right["L_e"]
    climb = loop.climb_lead_s * LOOPS["vertical"].numerator[0] / right["Z_t"]
    steps = np.diff(commands, axis=0, prepend=0.0)[:: round(DT_S / STEP_S)]
    return np.asarray(steps * np.array([pitch, roll, climb]))


def truth(effects: Effects = PLAIN) -> dict[str, float]:
    """Every derivative, from the linearised vehicle; world y is to the left, the paper's to the right."""
    vehicle = SimulatedVehicle(effects=effects)
    a = linearise(vehicle).a
    speed = vehicle.airframe.hover_rad_s
    degree = np.pi / 180.0
    return {
        "X_u": a[3, 3],
        "X_theta": a[3, 7] * degree,
        "Y_v": a[4, 4],
        "Y_phi": -a[4, 6] * degree,
        "Z_w": a[5, 5],
        "Z_t": a[5, 12:16].sum() * speed / 2.0,
        "M_e": (a[10, 12] - a[10, 14]) * speed / 2.0 / degree,
        "L_e": (a[9, 13] - a[9, 15]) * speed / 2.0 / degree,
        "motor": -a[12, 12],
    }


def planted() -> Plan:
    """The example of the documentation with two terms that the vehicle does not have."""
    text = FILE.read_text("utf-8")
    text = text.replace("[F.q]\n", '[F.q]\nvx = { name = "M_u", start = 0.0 }\n')
    text = text.replace("[F.p]\n", '[F.p]\np = { name = "L_p", start = 0.0 }\n')
    return Plan.parse(text)


def true_eigenvalues(right: dict[str, float]) -> FloatArray:
    """Those that are not zero: drags and the rotors' lag."""
    return np.sort(np.array([right["X_u"], right["Y_v"], right["Z_w"], *[-right["motor"]] * 3]))


def eigenvalue_errors(model: FittedStructured, right: dict[str, float]) -> FloatArray:
    """Distances from the true ones, relative to them; of those that are not zero."""
    true = true_eigenvalues(right)
    found = model.eigenvalues[-len(true) :]
    found = found[np.argsort(found.real)]
    return np.asarray(np.abs(found / true - 1.0))


def main(runs: int, first: int, effects: Effects) -> None:
    right = truth(effects)
    shares: dict[str, list[float]] = {name: [] for name in right}
    held: dict[str, list[bool]] = {name: [] for name in right}
    gone: dict[str, int] = dict.fromkeys((*right, *PLANTED), 0)
    modes = []
    spent = time.process_time()
    for run in range(runs):
        model = StructuredStateSpace(planted(), hold="none", band=BAND_RAD_S).fit(flown(first + run, effects))
        for name in gone:
            gone[name] += bool(model.derivative(name).dropped)
        for name, true in right.items():
            term = model.derivative(name)
            if not term.dropped:
                shares[name].append(term.value / true - 1.0)
                held[name].append(term.interval[0] <= true <= term.interval[1])
        modes.append(eigenvalue_errors(model, right).max())
        kept = ", ".join(f"{name} {100 * s[-1]:+.1f}" for name, s in shares.items() if s)
        planted_left = [name for name in PLANTED if not model.derivative(name).dropped]
        print(
            f"seed {first + run}: {kept} %; eigenvalues {100 * modes[-1]:.1f} %; kept {planted_left}",
            flush=True,
        )
    print(f"{runs} runs, {(time.process_time() - spent) / runs:.1f} s of CPU each")
    for name, values in shares.items():
        off = 100 * np.array(values)
        print(
            f"{name:8s} {right[name]:10.4g}: median {np.median(off):+6.2f} %, "
            f"worst {np.abs(off).max():5.2f} %, "
            f"interval holds {100 * np.mean(held[name]):3.0f} %, dropped {gone[name]} of {runs}"
        )
    every = np.abs(np.concatenate([np.array(v) for v in shares.values()]))
    print(f"derivatives within 10 %: {100 * np.mean(every < 0.1):.1f} % of {len(every)}")
    print(f"all eigenvalues within 5 %: {100 * np.mean(np.array(modes) < 0.05):.0f} % of runs")
    print("planted terms dropped: " + ", ".join(f"{name} {gone[name]} of {runs}" for name in PLANTED))
    print(f"true terms dropped: {sum(gone[name] for name in right)} of {runs * len(right)}")


if __name__ == "__main__":
    given = sys.argv[1:]
    count, seed = (*map(int, given[:2]), *(10, 1)[len(given[:2]) :])
    main(count, seed, ALL if given[2:] == ["all"] else PLAIN)
