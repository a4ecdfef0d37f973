"""Takagi-Sugeno models over lagged inputs and outputs: rules, their search, their words."""
