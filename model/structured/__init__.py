"""Structured state space: named derivatives and delays, fitted to all measured responses together."""
