"""The flight to fly next: signals to identify with, and what more flying would tell."""
