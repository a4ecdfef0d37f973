"""Flights that flysid simulates: plants, the nonlinear vehicle, wind, instruments, plans."""
