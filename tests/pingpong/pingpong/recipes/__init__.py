"""Recipes of ping-pong logs."""
