"""Takagi-Sugeno state-space models: rules over states of which some are hidden."""
