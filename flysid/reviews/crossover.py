"""Where a filter's phase counts: the crossover of the loop that the gains in a log make."""

from __future__ import annotations

from flysid.errors import FlysidError
from flysid.loops.judged import judge
from flysid.reviews.logged import LoggedFlight
from flysid.showing import significant

OTHERWISE_HZ = 30.0
"""Where vehicles of some kilograms cross over, for a log that does not determine it."""


def crossover_of(flight: LoggedFlight) -> tuple[float, str]:
    """Of the roll loop in Hz, where the log determines it; and how that is known."""
    unknown = f"not determined; {OTHERWISE_HZ:g} Hz are assumed (--crossover HZ)"
    try:
        (judged,) = judge([flight.log], ("roll",))[:1]
    except (FlysidError, ValueError):
        return OTHERWISE_HZ, unknown
    figure = judged.margins.crossover_hz if judged.margins is not None else None
    if figure is None or figure.value is None:
        return OTHERWISE_HZ, unknown
    edges = f"[{significant(figure.low)}, {significant(figure.high)}]"
    return figure.value, f"{significant(figure.value)} Hz {edges} of the roll loop, from the gains in the log"
