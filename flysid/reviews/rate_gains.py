"""The gains of a rate loop as a log states them, by the names that their firmware takes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flysid.ingest.lake.events import written
from flysid.laws.described import parameter_law
from flysid.loops.betaflight import AXES
from flysid.reviews.fact import Change
from flysid.reviews.logged import LoggedFlight

BLACKBOX = {"betaflight": "{term}_{axis}", "emuflight": "{term}_{axis}", "inav": "mc_{term}_{axis}"}
"""Firmware -> how its command line calls a gain."""
DIGITS = 2
"""Behind the first, of a gain that is proposed."""
SMALLER_D = ("d_min", "d_max")
"""Betaflight since 4.0 keeps a second D beside the first."""


def stated_gains(flight: LoggedFlight, axis: str) -> dict[str, float]:
    """Name -> value of P, I and D of an axis; {} where the log does not state them.

    >>> import flysid
    >>> from flysid.ingest.align.signals import FlightLog
    >>> stated_gains(LoggedFlight(FlightLog(flysid.read("sample_logs/01-multisine-seed1.tlog"))), "roll")
    {}
    """
    if flight.has("main"):
        return dict(_of_blackbox(flight, axis))
    letters = parameter_law("arducopter").part("axes")[axis]
    stems = (f"MC_{axis.upper()}RATE_", f"ATC_RAT_{letters}_", f"RATE_{letters}_")
    stated = flight.parameters
    stem = next((stem for stem in stems if stem + "P" in stated), None)
    if stem is None:
        return {}
    names = (stem + term for term in ("P", "I", "D"))
    return {name: float(written(stated[name])) for name in names if name in stated}


def _of_blackbox(flight: LoggedFlight, axis: str) -> Iterator[tuple[str, float]]:
    pattern = BLACKBOX.get(flight.family, BLACKBOX["betaflight"])
    terms = flight.headers.get(AXES[axis], "").split(",")
    for term, text in zip("pid", terms, strict=False):
        if text.strip().isdecimal():
            yield pattern.format(term=term, axis=axis), float(text)
    place = list(AXES).index(axis)
    for name in SMALLER_D:
        values = flight.headers.get(name, "").split(",")
        if len(values) > place and values[place].strip().isdecimal() and float(values[place]):
            yield f"{name}_{axis}", float(values[place])


def scaled_gains(
    flight: LoggedFlight,
    axis: str,
    factor: float,
    *,
    proportional: bool = True,
    integral: bool = True,
    slope: bool = True,
) -> list[Change]:
    """The gains of an axis that are not zero, multiplied, rounded towards what they are.

    `proportional`, `integral`, `slope`: whether P, I and D are among them.
    """
    wanted = {"p": proportional, "i": integral, "d": slope}
    whole = flight.has("main")
    found = []
    for name, old in stated_gains(flight, axis).items():
        if not old or not wanted[term_of(name)]:
            continue
        step = 1.0 if whole else 10.0 ** (np.floor(np.log10(factor * old)) - DIGITS)
        new = _rounded(factor * old, old, step)
        if new != old:
            found.append(Change(name, old, new))
    return found


def term_of(name: str) -> str:
    """ "p", "i" or "d" of "p_roll", "ATC_RAT_RLL_P", "d_min_roll"."""
    parts = name.lower().split("_")
    return next(part for part in (parts[-1], *parts) if part in ("p", "i", "d"))


def _rounded(value: float, old: float, step: float) -> float:
    """To a whole number of steps, towards the old value: never further from it than wanted."""
    steps = value / step
    slack = 1e-9 * steps
    whole = np.ceil(steps - slack) if value < old else np.floor(steps + slack)
    return float(f"{whole * step:.{DIGITS + 1}g}") if step < 1.0 else float(whole * step)
