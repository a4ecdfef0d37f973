"""The version of flysid, as files that it writes record it."""

__version__ = "0.1.0"
