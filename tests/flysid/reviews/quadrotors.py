"""The vehicles of several tests: one drawn for each subject, sound and with faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from bench.faulty_kinds import FAULTS, critical_gain
from bench.faulty_quadrotor import Flight, Quadrotor, draw_quadrotor
from tests.review_trials import vehicles

FlightsOf = Callable[[str], Mapping[str, Flight]]
"""The flights of a name of `fleet`, by kind."""
SPOILT_SEED = 3
"""Of the flights whose logs are spoilt."""


def drawn(seed: int) -> Quadrotor:
    return draw_quadrotor(np.random.default_rng(seed))


def known() -> dict[str, Quadrotor]:
    """One vehicle whose outcomes every firmware's log is to name."""
    sound = drawn(77)
    return {
        "sound": sound,
        "motor": replace(sound, fails_s=30.0),
        "propeller": replace(sound, fails_s=30.0, propeller=True),
        "slip": replace(sound, slips_s=24.0, slip_s=0.2),
        "jam": replace(sound, jam_s=25.0),
        "wires": replace(sound, wires=1.2 / sound.hover_a),
        "radio": replace(sound, incident="radio", incident_s=26.0),
        "EKF": replace(sound, incident="EKF", incident_s=28.0, drift_s=24.0, drift_m_s=2.0),
        "dropped": replace(sound, hard_m_s=3.0),
        "brown": replace(sound, browns_s=33.0),
        "starved": replace(sound, browns_s=33.0, warns=False),
        "collision": replace(sound, hits_s=30.0),
        "flyaway": replace(sound, strays_s=22.0, strays_rad=3.0),
        "station": replace(sound, incident="station", incident_s=27.0),
        "lively": replace(sound, lively_rad=0.5),
        "loose": replace(sound, loose_m_s2=60.0),
        "bent": replace(sound, bent=1, bent_m_s2=90.0, rpm=60.0 * 108.0 / np.sqrt(sound.hover)),
    }


def fleet() -> dict[str, dict[str, Quadrotor]]:
    """Under the name of what a test looks at: one vehicle, sound and with faults."""
    power, estimator, happened, plain = drawn(11), drawn(21), drawn(31), drawn(4)
    return {
        "known": known(),
        "power": {
            "sound": power,
            "worn": replace(power, weak=1, weakness=0.2),
            "propeller": replace(power, weak=1, weakness=0.2, propeller=True),
            "heavy": replace(power, heavier=1.2),
            "stopped": replace(power, fails_s=33.0),
            "sagging": FAULTS["sagging battery"].spoil(power, np.random.default_rng(0)),
        },
        "estimator": {
            "sound": estimator,
            "glitch": replace(estimator, glitch_s=31.0, glitch_m=22.0),
            "loose": replace(estimator, loose_m_s2=50.0),
        },
        "happened": {
            "sound": happened,
            "motor": replace(happened, fails_s=34.0),
            "brown-out": replace(happened, browns_s=41.0),
            "dropped": replace(happened, hard_m_s=3.5),
            "fence": replace(happened, incident="fence", incident_s=30.0),
            "battery": replace(happened, incident="battery", incident_s=30.0),
        },
        "plain": {
            "sound": plain,
            "weak": replace(plain, weak=2, weakness=0.2),
            "glitch": replace(plain, glitch_s=30.0, glitch_m=30.0),
            "hot": replace(plain, gain=1.2 * critical_gain(plain)),
        },
        "spoilt": {str(i): vehicle for i, vehicle in enumerate(vehicles(SPOILT_SEED))},
    }
