"""Where the documentation of an environment is, below the root of the site."""

from __future__ import annotations

import re

ONE_PAGE = frozenset({"rg", "ta"})
"""Namespaces of generated environments, which share one page."""

_VERSION = re.compile(r"-v\d+(?=-|$)", re.ASCII)
_WORD_BEGINS = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Za-z0-9])(?=[A-Z][a-z])")


def gallery_page(env_id: str) -> str:
    """Return the page of an environment in the gallery, as ``"gallery/game/guess-the-number/"``.

    Versions and variants of an environment have one page, and so has each namespace of ``ONE_PAGE``.
    """
    namespace, _, name = env_id.partition(":")
    if namespace in ONE_PAGE:
        return f"gallery/{namespace}/"
    family = _WORD_BEGINS.sub("-", _VERSION.split(name)[0])
    return f"gallery/{namespace.lower()}/{re.sub(r'[^a-z0-9]+', '-', family.lower()).strip('-')}/"
