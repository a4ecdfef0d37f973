"""Tables in text."""

from flysid.ingest.formats.base import Format

FORMATS = (Format("csv", "table in text (.csv, .tsv)", (".csv", ".tsv"), "flysid.ingest.formats.csv.reader"),)
