"""Logs that a Crazyflie writes to its uSD card."""

from flysid.ingest.formats.base import Format

FORMATS = (
    Format("crazyflie", "Crazyflie uSD-card log", (".usd",), "flysid.ingest.formats.crazyflie.reader"),
)
