"""Models of a fleet: triangles of every flight, models of groups of them, and which vehicles have changed."""
