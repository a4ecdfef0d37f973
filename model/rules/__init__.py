"""Takagi-Sugeno models: rules over lagged signals, or over states of which some are hidden."""
