"""Channels as transfer functions and step responses: identification, not judgement."""
