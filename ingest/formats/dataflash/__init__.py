"""ArduPilot DataFlash: binary and text."""

from flysid.ingest.formats.base import Format

FORMATS = (
    Format(
        "dataflash",
        "ArduPilot DataFlash (.bin)",
        (".bin",),
        "flysid.ingest.formats.dataflash.reader",
        "flysid.ingest.formats.dataflash.scrub",
    ),
    Format(
        "dataflash_text",
        "ArduPilot DataFlash as text (.log)",
        (".log",),
        "flysid.ingest.formats.dataflash.text_reader",
        "flysid.ingest.formats.dataflash.scrub_text",
    ),
)
