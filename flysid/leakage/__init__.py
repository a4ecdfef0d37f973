"""Whether a held-out flight is one of the training flights, whatever its name: `copies` asks."""
