"""Verbs that need a whole flight or several: `gains` on logs of autopilots, `fit` on training flights."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.gain_margins import autopilot_flight
from bench.truth.verbs import Score
from bench.verdict_fairness import judged, linear_plant, nonlinear_plant
from flysid.errors import FlysidError

FIRMWARES = ("px4", "ardupilot")
OUTER = (0.0, 3.0)
"""1/s of an angle loop around the rate loop; 0 where there is none."""


def score_gains(seed: int) -> tuple[dict[str, str], list[Score]]:
    """Kinds of a drawn flight, and the figures of its loop."""
    rng = np.random.default_rng(seed)
    firmware, outer = str(rng.choice(FIRMWARES)), float(rng.choice(OUTER))
    margins, true = autopilot_flight(firmware, continuous=False)(int(rng.integers(2**30)), outer)
    found = []
    for name, value in true.items():
        figure = getattr(margins, name, None)
        low, high = (figure.low, figure.high) if figure is not None else (None, None)
        known = low is not None and np.isfinite(low)
        found.append(Score(f"gains {name}", value, low if known else None, high if known else None))
    return {"plant": firmware, "loop": f"{outer:g} 1/s", "excitation": "pilot"}, found


def score_fit(seed: int) -> tuple[dict[str, str], list[Score]]:
    """Kind of a drawn plant; the change in error that `fit` states, and the sentences that follow from it.

    The truth is what the same two models show on many fresh flights of the plant. Where both are one model,
    it is 0, and neither sentence has a trial. A plant that `fit` refuses is one refusal.
    """
    rng = np.random.default_rng(seed)
    plant = linear_plant(rng) if rng.random() < 0.5 else nonlinear_plant(rng)
    kinds = {"plant": plant.name}
    try:
        outcome = judged(plant, rng, seed)
    except FlysidError:
        return kinds, [Score("fit", 1.0, None, None)]
    return kinds, list(_of_fit(outcome.verdict, outcome.low, outcome.high, outcome.truth))


def _of_fit(verdict: str, low: float | None, high: float | None, true: float | None) -> Iterator[Score]:
    yield Score("fit change, %", true, low, high)
    for word, is_right in (
        ("better", true is not None and true < 0),
        ("worse", true is not None and true > 0),
    ):
        said = (1.0, 1.0) if verdict == word else (None, None)
        yield Score(f"fit says {word}", 1.0 if is_right else None, *said)
