"""Backends: where the machine of an episode comes from."""
