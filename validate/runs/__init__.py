"""Runs of fitted models: fitted, kept in a folder, judged, listed, held against each other."""
