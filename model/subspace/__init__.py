"""Linear state space found by subspace methods, its filter, its refinement."""
