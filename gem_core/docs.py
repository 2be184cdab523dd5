"""Where the documentation is: the address of a page, and the gallery page of an environment."""

from __future__ import annotations

import re

SITE = "https://gem-core.readthedocs.io/"
"""The address of the documentation."""

ONE_PAGE = frozenset({"rg", "ta"})
"""Categories of many small families, which share one page of the gallery."""

_VERSION = re.compile(r"-v\d+(?=-|$)")
# Before a capital that follows a small letter, or that a small letter follows: HotpotQA, GSM8K, ASDiv.
_NEW_WORD = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Za-z0-9])(?=[A-Z][a-z])")
_MARKS = re.compile(r"[^a-z0-9]+")


def page_url(path: str = "") -> str:
    """Return the address of a page of the documentation.

    Args:
        path: Below the root of the site, as ``"terminal/"`` or ``"terminal/#when-something-is-missing"``.
    """
    return f"{SITE}{path}"


def gallery_page(env_id: str) -> str:
    """Return the path of an environment's page in the gallery, below the root of the site.

    All versions and variants of a family share a page: that of ``game:GuessTheNumber-v0-hard`` is
    ``gallery/game/guess-the-number/``.
    """
    category, _, name = env_id.partition(":")
    if category in ONE_PAGE:
        return f"gallery/{category}/"
    family = _VERSION.split(name, maxsplit=1)[0]
    slug = _MARKS.sub("-", _NEW_WORD.sub("-", family).lower()).strip("-")
    return f"gallery/{category}/{slug}/"
