"""Many logs in one folder: read in bounded workers, committed whole, opened again."""
