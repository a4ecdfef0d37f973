"""Betaflight's own firmware on vehicles that nobody knows: identify, predict, redesign, fly again, compare.

    python -m bench.sitl_campaign OUT [--vehicles 20] [--first 0] [--fly] [--yaw] > ROWS
    python -m bench.sitl_campaign ROWS... [--plot PICTURE]

Every vehicle (mass, inertia, motors' lag, noise, battery drawn) flies the firmware's own gains for 60 s, and
other sets of gains and filters for 40 s. From the first flight

- the response from setpoint to rate is predicted under each other set, with intervals, and compared with what
  that flight shows: within 2 dB and 10 deg from 1 to 30 Hz, as far as both flights know it;
- `flysid design` proposes settings. Their lines are typed into the firmware and flown with the same sticks.
  The error over the flight, noise and overshoot are compared with what was promised.

With --yaw vehicles turn about their vertical by their rotors' acceleration too, as real ones do, the sets are
those of yaw, and yaw is what is compared.

Flights in OUT are kept: the campaign resumes. With --fly it only flies. Several processes share the work by
--first, and the second form makes one table of what they printed. To an interval of one flight the scatter of
the other one is added before a line counts as missed, as in `bench.greenreaper`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench.sitl import Vehicle, fly
from flysid.errors import DataError
from flysid.ingest.lake.batch import ingest_logs
from flysid.ingest.lake.finding import find_logs
from flysid.ingest.lake.lake import open as open_lake
from flysid.ingest.lake.workers import Bounds
from flysid.loops.flight_errors import HIGHEST, NOISE_FROM_HZ, powers
from flysid.loops.forecast import Forecast, step_of
from flysid.loops.gain_bounds import RateBounds
from flysid.loops.known_axis import KnownAxis
from flysid.loops.proposal import Proposal, propose
from flysid.loops.stick_response import closed_loop
from flysid.pictures import save_picture

SETS: Sequence[Sequence[str]] = (
    (),
    ("set p_roll = 60", "set p_pitch = 62"),
    ("set d_roll = 45", "set d_pitch = 50", "set d_max_roll = 55", "set d_max_pitch = 60"),
    ("set p_roll = 34", "set i_roll = 110", "set p_pitch = 36", "set i_pitch = 110"),
    ("set dterm_lpf1_dyn_min_hz = 0", "set dterm_lpf1_static_hz = 50", "set p_roll = 55", "set p_pitch = 57"),
)
OF_YAW: Sequence[Sequence[str]] = (
    (),
    ("set p_yaw = 70",),
    ("set p_yaw = 32", "set i_yaw = 120"),
    ("set p_yaw = 60", "set yaw_lowpass_hz = 30"),
)
AXES = ("roll", "pitch")
REFERENCE_S, OTHER_S = 60.0, 40.0
WITHIN_DB, WITHIN_DEG = 2.0, 10.0
FROM_HZ, TO_HZ = 1.0, 30.0
STICKS = 180.0
"""us of the steps of the sticks."""
LEVEL = 0.95
PROMISED = {
    "tracking": "error, new over old",
    "overshoot": "overshoot of a step",
    "noise": "noise, new over old",
    "ms": "sensitivity Ms",
}


def drawn(seed: int) -> Vehicle:
    """A vehicle: mass, inertia, lag, noise and battery of its own.

    Inertia is 0.6 to 1.6 of the usual one, mass 0.85 to 1.2; the motors' lag 15 to 60 ms; noise up to twice,
    and half. In a minute the battery costs up to a tenth of the thrust.
    """
    rng = np.random.default_rng(seed)
    usual = Vehicle()
    size = rng.uniform(0.6, 1.6)
    inertia = tuple(size * rng.uniform(0.95, 1.05) * own for own in usual.inertia)
    noise = usual.noise * 2.0 ** rng.uniform(-1.0, 1.0)
    return Vehicle(
        mass=usual.mass * rng.uniform(0.85, 1.2),
        inertia=(inertia[0], inertia[1], inertia[2]),
        lag_s=rng.uniform(0.015, 0.06),
        noise=noise,
        battery=rng.uniform(0.0, 0.1),
    )


def turning(seed: int) -> Vehicle:
    """The same vehicle, turned by its props' drag, 9 to 18 mm, and by its rotors' acceleration."""
    rng = np.random.default_rng((seed, 1))
    return replace(drawn(seed), torque=rng.uniform(0.009, 0.018), reaction=rng.uniform(0.001, 0.004))


@dataclass(frozen=True)
class Trial:
    """What is compared: axes, sets of settings, how a vehicle is drawn, and what its folder is called."""

    axes: Sequence[str]
    sets: Sequence[Sequence[str]]
    vehicle: Callable[[int], Vehicle]
    name: str


TRIALS = {
    False: Trial(AXES, SETS, drawn, "vehicle"),
    True: Trial(("yaw",), OF_YAW, turning, "yaw"),
}


def compare(first: KnownAxis, later: KnownAxis) -> dict[str, Any]:
    """Lines that both flights know: predicted, and unchanged, against the measured response."""
    low = max(FROM_HZ, first.f[0], later.f[0])
    high = min(TO_HZ, first.f[-1], later.f[-1])
    both = np.intersect1d(later.f, first.f)  # a slow loop is measured in longer windows
    both = both[(both >= low) & (both <= high)]
    at, of = (np.isin(own.f, both) for own in (later, first))
    law = later.last.controller
    true = later.answers(law)[0][at]  # under its own law: as it was measured
    told, draws = (part[..., of] for part in first.answers(law))
    before, _ = first.answers(first.last.controller)
    found: dict[str, Any] = {"lines": int(at.sum()), "to_hz": float(high)}
    for name, own in (("predicted", told), ("unchanged", before[of])):
        off = own / true
        near = np.abs(20.0 * np.log10(np.abs(off))) <= WITHIN_DB
        found[name] = float(np.mean(near & (np.abs(np.degrees(np.angle(off))) <= WITHIN_DEG)))
        found[f"{name}_db"] = float(np.median(np.abs(20.0 * np.log10(np.abs(off)))))
    measured = closed_loop(later.last.loop.mean)[np.isin(later.last.loop.f, later.f[at])]
    scatter = closed_loop(later.last.loop.draws)[:, np.isin(later.last.loop.f, later.f[at])] - measured
    reach = np.quantile(np.abs(draws + scatter - told), LEVEL, axis=0)
    return found | {"held": float(np.mean(np.abs(measured - told) <= reach))}


def promised(told: Forecast, first: KnownAxis, later: KnownAxis) -> dict[str, Any]:
    """What a proposal promised, with its interval, and what it did when it was flown."""
    return {
        "tracking": _pair(told.tracking, _error(later) / _error(first)),
        "noise": _pair(told.noise, _noise(later) / _noise(first)),
        "overshoot": _pair(told.after.step.overshoot, _overshoot(later)),
        "ms": _pair(told.after.figures["ms"], _ms(later)),
        "better": told.better,
    }


def _pair(figure: Any, flown: float) -> dict[str, float | None]:
    return {"told": figure.value, "low": figure.low, "high": figure.high, "flown": flown}


def _error(known: KnownAxis) -> float:
    """Root mean square of setpoint less rate, over that of the setpoint: flights differ in their sticks."""
    _, sticks, errors = powers(known, known.band_hz[1])
    return float(np.sqrt(errors.sum() / sticks.sum()))


def _noise(known: KnownAxis) -> float:
    """Root mean square of the output above what the sticks move, without their part, thousandths."""
    loop, record = known.last.loop, known.last.record
    at = (loop.f >= NOISE_FROM_HZ) & (loop.f < HIGHEST * record.rate_hz)
    s = loop.mean[:, :, at]
    alone = s[1, 1].real - np.abs(s[0, 1]) ** 2 / s[0, 0].real
    levels = alone / np.abs(1.0 - np.exp(-2j * np.pi * loop.f[at] / record.rate_hz)) ** 2
    return float(np.sqrt(levels.sum() / sum(len(own) for own in loop.blocks)))


def _overshoot(known: KnownAxis) -> float:
    """Of a step, by the flight's own plant under its own law."""
    return float(step_of(known, known.last.controller).overshoot.value or 0.0)


def _ms(known: KnownAxis) -> float:
    back = known.last.controller.at_rest().feedback(known.f)
    return float(np.abs(1.0 / (1.0 + known.centre * back)).max())


def read(folder: Path) -> Any:
    """A log as flysid reads it."""
    if not (folder / "data").is_dir():
        path = sorted(folder.glob("LOG*.BF"))[-1]
        list(ingest_logs(find_logs([path], Bounds()), folder / "data", bounds=Bounds()))
    (log,) = open_lake(folder / "data").logs
    return log


def flown(folder: Path, trial: Trial, seed: int, k: int, settings: Sequence[str]) -> Path:
    """The folder of a flight, flown where it is not there yet; k of 0: with the sticks of the first one."""
    if not sorted(folder.glob("LOG*.BF")):
        fly(folder, OTHER_S if k else REFERENCE_S, 100 * seed + k, settings, trial.vehicle(seed), STICKS)
    return folder


def judge_sets(
    trial: Trial, first: Any, others: Sequence[tuple[int, Any]], seed: int
) -> list[dict[str, Any]]:
    """Every other set of gains, on each axis."""
    rows = []
    for axis in trial.axes:
        for k, other in others:
            row: dict[str, Any] = {"vehicle": seed, "axis": axis, "set": k}
            try:
                row |= compare(KnownAxis.of([first], axis), KnownAxis.of([other], axis))
            except DataError as error:
                row["refused"] = error.message
            rows.append(row)
    return rows


def judge_proposal(trial: Trial, folder: Path, first: Any, seed: int) -> list[dict[str, Any]]:
    """The proposal of a vehicle, flown."""
    found = propose([first], trial.axes, RateBounds())
    rows: list[dict[str, Any]] = [
        {"vehicle": seed, "axis": axis, "no proposal": why.message} for axis, why in found.refused.items()
    ]
    if not found.new:
        return rows
    lines = [f"set {name} = {value}" for name, value in found.new.items()]
    own = hashlib.sha256("\n".join(lines).encode()).hexdigest()[:8]  # another proposal is another flight
    later = read(flown(folder / f"proposed-{own}", trial, seed, 0, lines))
    for told in found.axes:
        row: dict[str, Any] = {"vehicle": seed, "axis": told.axis, "lines": lines_of(found, told.axis)}
        try:
            row |= promised(told, KnownAxis.of([first], told.axis), KnownAxis.of([later], told.axis))
        except DataError as error:
            row["refused"] = error.message
        rows.append(row)
    return rows


def lines_of(found: Proposal, axis: str) -> str:
    """The changes of an axis, for people."""
    own = {name: value for name, value in found.new.items() if not name.endswith(_others(axis))}
    return ", ".join(f"{name} {found.old[name]} -> {value}" for name, value in own.items())


def _others(axis: str) -> tuple[str, ...]:
    return tuple(f"_{other}" for other in ("roll", "pitch", "yaw") if other != axis)


def table(sets: Sequence[dict[str, Any]], proposals: Sequence[dict[str, Any]]) -> list[str]:
    """Lines of what came out."""
    known = [row for row in sets if "lines" in row]
    weight = np.array([row["lines"] for row in known], dtype=np.float64)
    vehicles = len({row["vehicle"] for row in sets})
    lines = [
        f"{vehicles} vehicles, {len(known)} of {len(sets)} loops compared, {weight.sum():.0f} lines",
        *(
            f"{name}: {100.0 * float(np.average([row[name] for row in known], weights=weight)):.1f} % {words}"
            for name, words in (
                ("predicted", f"of lines within {WITHIN_DB:g} dB and {WITHIN_DEG:g} deg"),
                ("unchanged", "the same, if nothing had changed"),
                ("held", "of lines in the interval"),
            )
        ),
    ]
    flew = [row for row in proposals if "tracking" in row]
    if not flew:
        return lines
    errors = np.array([row["tracking"]["flown"] for row in flew])
    lines.append(
        f"proposals: {len(flew)} axes flown, {len(proposals) - len(flew)} without; error down by a fifth on "
        f"{int((errors <= 0.8).sum())}, by anything on {int((errors < 1.0).sum())}, "
        f"in the median to {np.median(errors):.2f} times"
    )
    for name in PROMISED:
        inside = [
            row[name]["low"] <= row[name]["flown"] <= row[name]["high"] for row in flew if row[name]["told"]
        ]
        off = [abs(row[name]["flown"] / row[name]["told"] - 1.0) for row in flew if row[name]["told"]]
        lines.append(
            f"  {name}: promised to {100.0 * np.median(off):.1f} % in the median, "
            f"the interval holds {sum(inside)} of {len(inside)}"
        )
    return lines


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Shares of lines that are right, loop by loop, and what proposals promised against what they did."""
    from matplotlib.figure import Figure as Sheet

    known = [row for row in rows if "lines" in row and "set" in row]
    flew = [row for row in rows if "tracking" in row]
    sheet = Sheet(figsize=(9.0, 3.2), layout="constrained")
    shares, *others = sheet.subplots(1, 4)
    for name, words, color in (
        ("unchanged", "if nothing had changed", "0.6"),
        ("predicted", "predicted", "C0"),
    ):
        right = np.sort([row[name] for row in known])
        shares.plot(np.linspace(0.0, 1.0, len(right)), right, color=color, label=words)
    shares.set(xlabel="share of loops", title=f"lines within {WITHIN_DB:g} dB, {WITHIN_DEG:g} deg")
    shares.legend(fontsize=7)
    for axes, name, words in zip(others, PROMISED, PROMISED.values(), strict=False):
        own = [row[name] for row in flew if row[name]["told"]]
        told, low, high, flown = (np.array([row[key] for row in own]) for key in own[0])
        axes.errorbar(
            flown, told, [told - low, high - told], fmt=".", color="C0", elinewidth=0.7, markersize=3
        )
        axes.axline((float(flown.min()), float(flown.min())), slope=1.0, color="0.6", linewidth=0.8)
        axes.set(xlabel="flown", title=words)
    others[0].set(ylabel="promised, with its interval")
    save_picture(sheet, path)


def run(out: Path, trial: Trial, seeds: Sequence[int], only_fly: bool) -> None:
    """Fly what is not flown yet, and print a row for every loop."""
    for seed in seeds:
        folder = out / f"{trial.name}-{seed:02d}"
        folders = [flown(folder / f"set-{k}", trial, seed, k, own) for k, own in enumerate(trial.sets)]
        if only_fly:
            continue
        first, *others = (read(own) for own in folders)
        for row in judge_sets(trial, first, list(enumerate(others, 1)), seed):
            print(json.dumps(row), flush=True)
        for row in judge_proposal(trial, folder, first, seed):
            print(json.dumps(row), flush=True)


def main() -> None:
    """Fly, or print the table of what was printed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("paths", type=Path, nargs="+")
    parser.add_argument("--vehicles", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--fly", action="store_true")
    parser.add_argument("--yaw", action="store_true")
    parser.add_argument("--plot", type=Path)
    options = parser.parse_args()
    if not options.paths[0].is_file():
        seeds = range(options.first, options.first + options.vehicles)
        run(options.paths[0], TRIALS[options.yaw], seeds, options.fly)
        return
    lines = [line for path in options.paths for line in path.read_text("utf-8").splitlines()]
    rows = [json.loads(line) for line in lines if line.startswith("{")]
    sets = [row for row in rows if "set" in row]
    print("\n".join(table(sets, [row for row in rows if "set" not in row])))
    if options.plot:
        draw(rows, options.plot)


if __name__ == "__main__":
    main()
