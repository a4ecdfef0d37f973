"""Spectra of what a vehicle measures, and the filters that its firmware applies."""
