"""Wrappers that come with the core; a new one gets a file here and a record in ``gem_core/_plugin.py``."""
