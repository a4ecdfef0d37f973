"""Fleets: many logs of many vehicles, in object stores and on more than one machine."""
