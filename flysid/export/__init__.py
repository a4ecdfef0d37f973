"""Fitted models for other programs: C99, FMU, MATLAB text."""
