"""Bands of free runs to first order, and of draws of the numbers: python -m bench.ts_bands [NAME...]

TS with its defaults is fitted to plants of `ts_plants`. Per plant: the first-order band's width in widths of
a band from steps a ten-thousandth as large, where both must agree; the width of the band of whole draws in
widths of the first-order one, how far its middle lies off the run, in halves of its own width, and the share
of draws that the output limits cut off.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from bench.ts_plants import PLANTS
from flysid.dataset import Segment
from flysid.model.polynomials import Z95
from flysid.model.rules.rule_uncertainty import Uncertainty, uncertainty
from flysid.model.ts import TS, over_lags

USUAL = ("saturated", "duffing", "stiff", "tanks", "arm", "wiener")
STEP = 1e-4


def compared(sure: Uncertainty, segment: Segment) -> tuple[float, float, float, float]:
    """First order by small steps, whole draws by first order; how lopsided these are, how often cut off."""
    u = segment.u
    y0 = segment.y[: sure.model.n_init]
    run = sure.model.simulate(u, y0)
    low, high = sure.simulation_band(u, y0)
    near = replace(sure, covariance=STEP**2 * sure.covariance).draws(400)
    moved = np.array([m.simulate(u, y0) - run for m in near])
    reach = Z95 / STEP * np.sqrt(np.mean(moved**2, axis=0))
    drawn = np.array([m.simulate(u, y0) for m in sure.draws()])
    below, above = np.percentile(drawn, (2.5, 97.5), axis=0)
    least, most = sure.model.output_limits
    cut = ((drawn <= least) | (drawn >= most)).any(axis=(1, 2)).mean()
    aside = np.abs(above + below - 2 * run)[len(y0) :] / (above - below)[len(y0) :]
    wide = float(np.sum(high - low))
    return (
        wide / float(np.sum(2 * reach)),
        float(np.sum(above - below)) / wide,
        float(np.median(aside)),
        float(cut),
    )


def main() -> None:
    """Print a line per plant."""
    print(f"{'plant':12s} {'first / small':>14s} {'draws / first':>14s} {'draws aside':>12s} {'cut off':>8s}")
    for name in sys.argv[1:] or USUAL:
        plant = PLANTS[name](np.random.default_rng(0))
        sure = uncertainty(over_lags(TS(), plant.train), plant.train)
        small, wide, aside, cut = compared(sure, plant.test.segments[0])
        print(f"{name:12s} {small:14.3f} {wide:14.1f} {aside:12.2f} {cut:8.2f}", flush=True)


if __name__ == "__main__":
    main()
