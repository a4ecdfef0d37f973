"""Channels of a known plant, flown well or badly, as a run would hand them over."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from flysid.dataset import Dataset, FloatArray, Segment, Signal
from flysid.ingest.align.doubts import Doubt
from flysid.ingest.synth.plants import LOOPS, fly
from flysid.model.arx import ARX
from flysid.model.mean import Mean
from flysid.validate.runs.run import ChannelRun, HeldOut

DT_S = 0.02
LIMIT = 12.0
NOISE = 0.02


def steps(rng: np.random.Generator, size: float, seconds: float = 40.0) -> FloatArray:
    """(N, 1) random steps of a second."""
    held = round(1.0 / DT_S)
    return np.repeat(rng.uniform(-size, size, round(seconds)), held)[:, None]


def answer(u: FloatArray, rng: np.random.Generator, gain: float = 1.0) -> FloatArray:
    """(N, 1) the paper's longitudinal loop, with noise."""
    y = gain * fly(LOOPS["longitudinal"], u[:, 0], DT_S)
    return np.asarray(y + NOISE * rng.standard_normal(len(y)))[:, None]


def channel(
    segments: list[tuple[FloatArray, FloatArray]],
    *,
    units: tuple[str, str] = ("deg", "m/s"),
    doubts: tuple[Doubt, ...] = (),
    loops: tuple[str, ...] = (),
) -> HeldOut:
    """Three quarters of the segments to train ARX on, the others held out."""
    signals = ((Signal("theta_in", units[0]),), (Signal("v_x", units[1]),))
    parts = tuple(
        Segment(u=u, y=y, t0_ns=i * 10**11, flight=f"flight {i}") for i, (u, y) in enumerate(segments)
    )
    data = Dataset(DT_S, *signals, parts, "longitudinal")
    cut = (3 * len(parts)) // 4
    train = replace(data, segments=parts[:cut])
    models = {"mean": Mean().fit(train), "arx": ARX(na=2, nb=2, nk=1).fit(train)}
    run = ChannelRun("longitudinal", {}, {}, baseline="arx", doubts=doubts, loops=loops)
    return HeldOut(run, models, train, replace(data, segments=parts[cut:]), train.flights)


@cache
def good(seed: int = 0, size: float = 8.0, gain: float = 1.0) -> HeldOut:
    """Eight flights that identify the plant."""
    rng = np.random.default_rng(seed)
    inputs = [steps(rng, size) for _ in range(8)]
    return channel([(u, answer(u, rng, gain)) for u in inputs])
