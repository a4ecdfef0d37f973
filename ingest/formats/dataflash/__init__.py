"""ArduPilot DataFlash: binary and text."""
