"""Rate controllers of autopilots as data: a table for each firmware, an entry for each range of versions."""
