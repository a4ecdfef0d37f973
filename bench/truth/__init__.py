"""Printed figures against plants drawn at random: see `bench.truth.__main__`."""
