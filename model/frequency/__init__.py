"""Frequency responses as measured, and transfer functions in s fitted to them."""
