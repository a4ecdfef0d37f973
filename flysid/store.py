"""Flight to parquet and back, each with a format version. The manifest, written last, commits a flight."""
