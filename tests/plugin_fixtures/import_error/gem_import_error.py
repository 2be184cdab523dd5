"""Fails with an ImportError inside."""

from gem_core import nothing_of_this_name  # noqa: F401
