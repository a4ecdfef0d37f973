"""Tests of the facts about a flight."""
