"""Tests of flysid."""
