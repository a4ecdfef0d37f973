"""Plan the next flight: signals to identify with, and the precision they would bring."""
