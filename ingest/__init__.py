"""Bytes to Flight to Dataset. One file per log format; see `base` for what a format must provide."""
