"""Agents that come with the core; a new one gets a file here and a record in ``_plugin.py``."""
