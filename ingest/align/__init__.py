"""Flight to Dataset: recipes, clocks, grids, gaps, conditions, and doubts about the data."""
