"""Tables in parquet files."""

from flysid.ingest.formats.base import Format

FORMATS = (
    Format(
        "parquet", "table in parquet (.parquet)", (".parquet", ".pq"), "flysid.ingest.formats.parquet.reader"
    ),
)
