"""Log formats: one folder each, and one row in `registry`."""
