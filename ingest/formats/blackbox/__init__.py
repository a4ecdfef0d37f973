"""Betaflight, INAV, Cleanflight and Rotorflight blackbox."""
