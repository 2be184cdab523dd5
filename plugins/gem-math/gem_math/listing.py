"""The data sets of ``math:*``, and those of ``eval:*`` that are graded like them."""

from __future__ import annotations

from collections.abc import Iterator

from gem_core.specs import EnvSpec


def math_specs() -> Iterator[EnvSpec]:
    """Give the records of the data sets."""
    yield from ()
