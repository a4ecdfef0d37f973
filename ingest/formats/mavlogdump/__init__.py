"""Lines of JSON that pymavlink prints."""
