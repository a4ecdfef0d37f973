"""Find held-out flights that are training flights under another name: see `copies`."""
