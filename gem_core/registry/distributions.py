"""Installed distributions, by their metadata."""

from __future__ import annotations

import importlib.metadata
import re

# A line of a distribution's metadata that belongs to an extra: the package and the extra.
_OF_EXTRA = re.compile(r"""([\w.-]+).*;.*\bextra\s*==\s*["']([\w.-]+)["']""")


def installed_version(name: str) -> str | None:
    """Return the version of a distribution, or None if it is not installed."""
    try:
        return importlib.metadata.version(name)
    except (importlib.metadata.PackageNotFoundError, ValueError):
        return None


def extras_of(distribution: str) -> dict[str, list[str]]:
    """Return the extras of a distribution, each with the packages that it adds; none if it is not installed."""
    try:
        lines = importlib.metadata.requires(distribution) or []
    except (importlib.metadata.PackageNotFoundError, ValueError):
        lines = []
    extras: dict[str, list[str]] = {}
    for match in filter(None, map(_OF_EXTRA.match, lines)):
        extras.setdefault(match[2], []).append(match[1])
    return extras
