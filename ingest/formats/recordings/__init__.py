"""Recordings of several files, which a recorder split by size or time."""
