"""The names of what comparisons hold models against; the baseline is chosen in `model.linear_choice`."""

from __future__ import annotations

REFERENCES = ("mean", "persistence")
"""Structures that no verdict is about: what loses to them has learnt nothing."""
