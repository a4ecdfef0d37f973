"""One page about a vehicle: does it fly well, and what should be changed."""
