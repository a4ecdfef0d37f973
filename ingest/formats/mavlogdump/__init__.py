"""Lines of JSON that pymavlink prints."""

from flysid.ingest.formats.base import Format

FORMATS = (
    Format(
        "mavlogdump", "JSON lines of pymavlink's mavlogdump", (), "flysid.ingest.formats.mavlogdump.reader"
    ),
)
