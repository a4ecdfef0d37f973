"""What a log must hold before it is worth a fit: one rule for `doctor`, `ls --suggest` and shipped recipes.

Rates are the least that shipped recipes ask for (tests/ingest/lake/test_suggest.py compares). A flight by
itself is judged on the 30 % of it that are held out. Below ten correlation lengths of the error only a large
difference can be seen there (docs/measured/verdicts.md), and the errors of models of attitude or velocity are
correlated over one to two seconds.
"""

from __future__ import annotations

LEAST_HZ = {"attitude": 8.0, "velocity": 2.0, "rates": 25.0}
BLACKBOX_RATES_HZ = 200.0
"""Of Betaflight and INAV, whose logs hold the inner loop."""
MIN_DURATION_S = 10.0
"""Below, nothing is fitted that would be worth a look."""


FLY_MORE = "fly a minute of manoeuvres, or five such flights"


def least_hz(role: str, log_format: str) -> float:
    """The lowest rate at which "attitude", "velocity" or "rates" of a log are worth a fit."""
    return BLACKBOX_RATES_HZ if role == "rates" and log_format == "blackbox" else LEAST_HZ[role]


def too_short_alone(duration_s: float, *, least_s: float = 60.0) -> str:
    """Why a flight of this duration will hardly give a verdict by itself; "" where it may."""
    if round(duration_s) >= least_s:
        return ""
    return f"{duration_s:.0f} s alone will hardly give a verdict: {FLY_MORE}"
