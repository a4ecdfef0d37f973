"""Betaflight, INAV, Cleanflight and Rotorflight blackbox."""

from flysid.ingest.formats.base import Format

FORMATS = (
    Format(
        "blackbox",
        "Betaflight and INAV blackbox (.bbl, .bfl, .txt)",
        (".bbl", ".bfl", ".txt"),
        "flysid.ingest.formats.blackbox.reader",
        "flysid.ingest.formats.blackbox.scrub",
    ),
)
