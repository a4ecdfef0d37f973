"""Parameters that log a missing stream on the next flight, by firmware: from `remedies.toml`."""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files

from flysid.reviews.logged import LoggedFlight


def remedy(flight: LoggedFlight, of: str, otherwise: str = "") -> str:
    """The parameter of this log's firmware; `otherwise` where none is known."""
    whose = flight.family or flight.info.get("vehicle", "").lower()  # a Crazyflie names no autopilot
    return _remedies().get(whose, {}).get(of, otherwise)


@cache
def _remedies() -> dict[str, dict[str, str]]:
    return tomllib.loads(files(__package__).joinpath("remedies.toml").read_text("utf-8"))
