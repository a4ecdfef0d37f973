"""Tables in parquet files."""
