"""Logs that a Crazyflie writes to its uSD card."""
