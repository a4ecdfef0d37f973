"""Models that flysid did not make: MATLAB, python-control, FMUs, Python functions; judged beside its own."""
