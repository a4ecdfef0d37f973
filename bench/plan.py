"""What a plan is worth, and whether predicted intervals come true.

`python -m bench.plan signals`: correlation and relative peak factor of planned multisines, beside random
phases clipped flat (`ingest/synth`), for several bands.
`python -m bench.plan axes [runs] [first seed]`: three axes in one 60 s record against three records of 60 s;
a plant of three inputs and outputs that couple by a tenth, ARX of its order.
`python -m bench.plan widths [runs] [first seed]`: widths predicted from 60 s for 240 s, beside those after;
ARX of the plant's order.
`python -m bench.plan rules [runs] [first seed]`: the same of every rule of a TS model, from 75 s for 300 s.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from bench.ts_intervals import DT_S, known_model, steps
from flysid.dataset import Dataset, FloatArray
from flysid.ingest.synth.manoeuvres import random_phase_multisine
from flysid.model.arx import ARX
from flysid.model.rules.fitted import FittedTS
from flysid.model.ts import TS, over_lags
from flysid.plan.flightplan import CommandedAxis, make_plan
from flysid.plan.multisines import largest_correlation, relative_peak_factor
from flysid.plan.precision import Known, known_of_model

RATE_HZ = 25.0
BAND_HZ = (0.1, 4.0)
AXES = tuple(CommandedAxis(name, 1.0) for name in ("roll", "pitch", "yaw"))
SECONDS = 60.0
MORE = 180.0
NOISE = 0.2
BANDS = (((0.1, 4.0), 30.0), ((0.02, 0.8), 60.0), ((0.3, 12.0), 60.0), ((0.2, 25.0), 20.0))
"""Hz, and seconds of a period."""


def plant(u: FloatArray, speed: float = 4.0) -> FloatArray:
    """Second order, damping 0.5, sampled."""
    s = speed * (-0.5 + 1j * np.sqrt(0.75))
    a = np.real(np.poly(np.exp(np.array([s, np.conj(s)]) / RATE_HZ)))
    return np.asarray(lfilter([0.0, a.sum() / 2, a.sum() / 2], a, u))


def coloured(n: int, rng: np.random.Generator) -> FloatArray:
    """Noise of a time constant of 0.2 s."""
    pole = np.exp(-1.0 / (0.2 * RATE_HZ))
    return np.asarray(lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], rng.standard_normal(n)))


def answer(u: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(N, 3) outputs of three axes that couple by a tenth."""
    mixed = u + 0.1 * np.roll(u, 1, axis=1)
    own = np.column_stack([plant(mixed[:, j], 3.0 + j) for j in range(3)])
    return own + NOISE * np.column_stack([coloured(len(u), rng) for _ in range(3)])


def signals(bands: Sequence[tuple[tuple[float, float], float]] = BANDS) -> None:
    """Correlation and relative peak factor."""
    print("band, Hz    s   lines        correlation  relative peak factor   clipped random phases")
    for band, seconds in bands:
        plan = make_plan("multisine", AXES, band, seconds, 5 * band[1])
        time_s = np.arange(len(plan.u)) / plan.rate_hz
        other = np.column_stack(
            [random_phase_multisine(time_s, band, 1.0, np.random.default_rng(j)) for j in range(3)]
        )
        factors = " ".join(f"{f:.3f}" for f in plan.peak_factors)
        before = " ".join(f"{relative_peak_factor(x):.3f}" for x in other.T)
        counts = "+".join(str(len(own)) for own in plan.lines)
        print(
            f"{band[0]:g} to {band[1]:g}  {seconds:g}  {counts}  {plan.correlation:.0e}  {factors}  "
            f"{before}, correlation {largest_correlation(other):.2f}"
        )


def gain(data: Dataset, source: int) -> Known:
    """The steady gain of an ARX."""
    model = ARX(na=2, nb=2, nk=1).fit(data)
    names = f"gain of {data.inputs[source].name} to {data.outputs[0].name}"
    return next(k for k in known_of_model(model, len(data) / RATE_HZ) if k.what == names)


def axes(runs: int, first: int) -> None:
    """Interval of every axis's own gain from one record, over that from a record of its own."""
    plan = make_plan("multisine", AXES, BAND_HZ, SECONDS, RATE_HZ)
    ratios = []
    for seed in range(first, first + runs):
        rng = np.random.default_rng(seed)
        together = answer(plan.u, rng)
        for j in range(3):
            y = together[:, [j]]
            one_of = Dataset.from_arrays(plan.u, y, 1.0 / RATE_HZ)
            one = make_plan("multisine", AXES[:1], BAND_HZ, SECONDS, RATE_HZ)
            u = np.zeros_like(plan.u)
            u[:, j] = one.u[:, 0]
            alone = Dataset.from_arrays(u[:, [j]], answer(u, rng)[:, [j]], 1.0 / RATE_HZ)
            ratios.append(gain(one_of, j).share / gain(alone, 0).share)
    print(f"width from one record of three axes, over a record of its own: median {np.median(ratios):.3f}, ")
    print(
        f"5 and 95 %: {np.percentile(ratios, 5):.3f}, {np.percentile(ratios, 95):.3f} ({len(ratios)} pairs)"
    )


def widths_of(seed: int, settings: ARX) -> tuple[float, float, float]:
    """Share known from 60 s, predicted for 240 s, and known from 240 s."""
    rng = np.random.default_rng(seed)
    plan = make_plan("multisine", AXES[:1], BAND_HZ, SECONDS, RATE_HZ)
    u = np.tile(plan.u, (1 + round(MORE / SECONDS), 1))
    y = plant(u[:, 0]) + NOISE * coloured(len(u), rng)
    n = len(plan.u)
    found = []
    for rows in (n, len(u)):
        model = settings.fit(Dataset.from_arrays(u[:rows], y[:rows], 1.0 / RATE_HZ))
        found.append(next(known_of_model(model, rows / RATE_HZ)))
    return found[0].share, found[0].share_after(MORE), found[1].share


def widths(runs: int, first: int) -> None:
    """Predicted over real widths."""
    told(np.array([widths_of(seed, ARX(na=2, nb=2, nk=1)) for seed in range(first, first + runs)]))


def told(table: FloatArray) -> None:
    """Print (N, 3) shares known, predicted and that came."""
    ratio = table[:, 1] / table[:, 2]
    near = 100 * np.mean(np.abs(ratio - 1.0) <= 0.3)
    print(
        f"known to {100 * np.median(table[:, 0]):.2g} %, predicted {100 * np.median(table[:, 1]):.2g}, came "
        f"{100 * np.median(table[:, 2]):.2g}; predicted within 30 % of what came in {near:.0f} % of "
        f"{len(table)} (ratio {ratio.min():.2f} to {ratio.max():.2f})"
    )


def widths_of_rules(seed: int, truth: FittedTS) -> list[tuple[float, float, float]]:
    """As `widths_of`, of both rules' gains; noise coloured by a pole at 0.8."""
    u = steps(500 + seed, 6000)
    white = 0.03 * np.random.default_rng(seed).standard_normal(len(u))
    y = truth.simulate(u, np.zeros((truth.n_init, 1))) + lfilter([1.0], [1.0, -0.8], white)[:, None]
    found = []
    for rows in (1500, 6000):
        data = Dataset.from_arrays(u[:rows], y[:rows], DT_S)
        model = over_lags(TS(rules=2, na=1, nb=1, nk=1, antecedents=("u(k-1)",)), data)
        found.append(list(known_of_model(model, rows * DT_S, train=data)))
    return [(a.share, a.share_after(4500 * DT_S), b.share) for a, b in zip(*found, strict=True)]


def rules(runs: int, first: int) -> None:
    """Predicted over real widths."""
    truth = known_model()
    told(np.array([row for seed in range(first, first + runs) for row in widths_of_rules(seed, truth)]))


if __name__ == "__main__":
    kind, *rest = sys.argv[1:] or ["signals"]
    count, seed_0 = (*map(int, rest), *(20, 1000)[len(rest) :])
    if kind == "signals":
        signals()
    elif kind == "axes":
        axes(count, seed_0)
    elif kind == "rules":
        rules(count, seed_0)
    else:
        widths(count, seed_0)
