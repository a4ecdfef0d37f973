"""Model and held-out Dataset to Report: fair comparison in physical units."""
