"""MCAP containers."""
