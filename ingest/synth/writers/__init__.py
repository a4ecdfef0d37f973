"""Simulated flights as logs: one writer per format."""
