"""Flight to Dataset: recipes, units, clocks, grids, gaps and conditions."""
