"""A table-tennis ball on a jet of air: its log format, its model, a verb, a recipe and a figure."""
